-- Wireshark dissector of netlab's flood (`mesh: flood`, netlab/flood/wire.py): header and the Ethernet frame inside.
--
-- Others may use the same EtherType, which is for local experiments. So whoever comes later hands on what is not its
-- own to whoever was there before.

local checksums = require "checksums"

local ETHERTYPE, VERSION, HEADER_BYTES, ETHERNET_BYTES = 0x88B5, 1, 18, 14

local flood = Proto("netlab_flood", "netlab flood")
local f = flood.fields
f.version = ProtoField.uint8("netlab_flood.version", "Version")
f.hop_limit = ProtoField.uint8("netlab_flood.hop_limit", "Hop limit")
f.check = ProtoField.uint16("netlab_flood.check", "Check (CRC-16/CCITT)", base.HEX)
f.length = ProtoField.uint16("netlab_flood.length", "Length of the frame inside", base.UNIT_STRING,
    { " byte", " bytes" })
f.originator = ProtoField.ether("netlab_flood.originator", "Originator")
f.epoch = ProtoField.uint16("netlab_flood.epoch", "Epoch", base.HEX)
f.sequence = ProtoField.uint32("netlab_flood.sequence", "Sequence number")
flood.experts.check = ProtoExpert.new("netlab_flood.expert.check", "Wrong check: nobody takes it",
    expert.group.CHECKSUM, expert.severity.ERROR)
flood.experts.length = ProtoExpert.new("netlab_flood.expert.length", "Impossible length: nobody takes it",
    expert.group.MALFORMED, expert.severity.ERROR)

local types = DissectorTable.get("ethertype")
local former = types:get_dissector(ETHERTYPE)

-- A damaged header is still the flood's, unless it has the mark of udp_mesh, which shares the EtherType.
local function is_own(bytes)
    if #bytes < HEADER_BYTES or bytes:byte(1) ~= VERSION then
        return false
    end
    return bytes:sub(3, 4) ~= "uM" or checksums.crc16(bytes:sub(5, HEADER_BYTES)) == bytes:byte(3) * 256 + bytes:byte(4)
end

function flood.dissector(tvb, pinfo, tree)
    local bytes = tvb:len() > 0 and tvb:raw() or ""
    if not is_own(bytes) then
        return former and former:call(tvb, pinfo, tree) or 0
    end
    local item = tree:add(flood, tvb(0, HEADER_BYTES))
    item:add(f.version, tvb(0, 1))
    item:add(f.hop_limit, tvb(1, 1))
    local check = item:add(f.check, tvb(2, 2))
    local length_item = item:add(f.length, tvb(4, 2))
    item:add(f.originator, tvb(6, 6))
    item:add(f.epoch, tvb(12, 2))
    item:add(f.sequence, tvb(14, 4))
    pinfo.cols.protocol = "flood"
    local text = string.format("%s #%d, hop limit %d", tostring(tvb(6, 6):ether()), tvb(14, 4):uint(), tvb(1, 1):uint())
    pinfo.cols.info = text
    item:append_text(", " .. text)
    local length, room = tvb(4, 2):uint(), tvb:len() - HEADER_BYTES
    if checksums.crc16(bytes:sub(5, HEADER_BYTES)) ~= tvb(2, 2):uint() then
        check:add_proto_expert_info(flood.experts.check)
    elseif length < ETHERNET_BYTES or length > room then
        length_item:add_proto_expert_info(flood.experts.length)
    else
        Dissector.get("eth_withoutfcs"):call(tvb(HEADER_BYTES, length):tvb(), pinfo, tree)
    end
    return tvb:len()
end

types:add(ETHERTYPE, flood)
