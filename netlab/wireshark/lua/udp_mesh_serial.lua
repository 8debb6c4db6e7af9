-- udp_mesh on a serial line (docs/wire.md, Carriers): COBS, target, source, datagram, CRC-32. One record of the capture
-- is one frame of the line, with or without the zero after it.
--
-- A serial line has no link type of its own: tell Wireshark which of the user's (DLT_USER) it is, as docs/wireshark.md
-- says.

local checksums = require "checksums"

local carrier = Proto("udp_mesh_serial", "udp_mesh on a serial line")
local f = carrier.fields
f.target = ProtoField.uint16("udp_mesh_serial.target", "Target", base.HEX)
f.source = ProtoField.uint16("udp_mesh_serial.source", "Source", base.HEX)
f.crc = ProtoField.uint32("udp_mesh_serial.crc", "CRC-32", base.HEX)
carrier.experts.stuffing = ProtoExpert.new("udp_mesh_serial.expert.stuffing", "Damaged: no COBS frame",
    expert.group.MALFORMED, expert.severity.ERROR)
carrier.experts.crc = ProtoExpert.new("udp_mesh_serial.expert.crc", "Damaged: wrong CRC-32",
    expert.group.CHECKSUM, expert.severity.ERROR)

local MIN_BYTES = 8 -- target, source, CRC
local LONGEST_BLOCK = 254

-- Undoes the stuffing; nil if this is no frame.
local function unstuffed(frame)
    local parts, at = {}, 1
    while at <= #frame do
        local code = frame:byte(at)
        if code == 0 or at + code - 1 > #frame then
            return nil
        end
        parts[#parts + 1] = frame:sub(at + 1, at + code - 1)
        at = at + code
        if code <= LONGEST_BLOCK and at <= #frame then
            parts[#parts + 1] = "\0"
        end
    end
    return table.concat(parts)
end

function carrier.dissector(tvb, pinfo, tree)
    pinfo.cols.protocol = "udp_mesh_serial"
    local item = tree:add(carrier, tvb())
    local bytes = unstuffed((tvb:raw():gsub("\0$", "")))
    if not bytes or #bytes < MIN_BYTES then
        item:add_proto_expert_info(carrier.experts.stuffing)
        return tvb:len()
    end
    local line = ByteArray.new(bytes, true):tvb("Unstuffed frame")
    item:add(f.target, line(0, 2))
    item:add(f.source, line(2, 2))
    local crc_item = item:add(f.crc, line(#bytes - 4, 4))
    if checksums.crc32(bytes:sub(1, -5)) ~= line(#bytes - 4, 4):uint() then
        crc_item:add_proto_expert_info(carrier.experts.crc)
    elseif #bytes > MIN_BYTES then
        Dissector.get("udp_mesh"):call(line(4, #bytes - MIN_BYTES):tvb(), pinfo, tree)
    end
    return tvb:len()
end
