-- Wireshark dissector of udp_mesh (docs/wire.md): where a datagram goes through. docs/wireshark.md is the manual.
--
-- udp_mesh_wire.lua reads the bytes, udp_mesh_conversations.lua knows what datagrams have to do with each other,
-- udp_mesh_tree.lua shows both, with what udp_mesh_fields.lua names; Wireshark loads these files by themselves, too,
-- which does nothing. udp_mesh_ethernet.lua and udp_mesh_serial.lua call this dissector for other carriers than UDP.
-- For payloads there is a dissector table by topic, udp_mesh.topic.

local wire = require "udp_mesh_wire"
local fields = require "udp_mesh_fields"
local conversations = require "udp_mesh_conversations"
local show = require "udp_mesh_tree"

local udp_mesh = Proto("udp_mesh", "udp_mesh")
DissectorTable.new("udp_mesh.topic", "udp_mesh topic", ftypes.STRING)

udp_mesh.prefs.ports = Pref.range("UDP ports", "8700",
    "Ports on which everything that begins as udp_mesh is taken for it", 65535)
udp_mesh.prefs.grace_us = Pref.uint("Grace of priority inversions (us)", 1000,
    "A fragment that left within this time after a more urgent message was published could not be called back. "
    .. "To judge as netlab does, add the time that a full frame takes on the link: 12000 at 1 Mbit/s")

udp_mesh.fields = fields.fields
udp_mesh.experts = fields.experts

local frame_time = Field.new("frame.time_epoch")
local interface_id = Field.new("frame.interface_id")
local direction = Field.new("frame.packet_flags_direction")
local link_source = Field.new("eth.src")
local INBOUND = 1

-- Conversations of this file, the second of its first datagram, and the last frame that was taken note of.
local known, base_s, last_frame

function udp_mesh.init()
    known, base_s, last_frame = conversations.new(), nil, 0
    show.names = known.names
end

-- Where and when a datagram was seen, in the terms of udp_mesh_conversations.lua.
local function sight_of(key, pinfo)
    local time, interface, flow = frame_time().value, interface_id(), direction()
    base_s = base_s or time.secs
    local sources = {}
    for _, from in ipairs({ link_source() }) do
        sources[#sources + 1] = tostring(from.value)
    end
    local way = flow and flow.value or 0
    return {
        key = key,
        frame = pinfo.number,
        t_s = (time.secs - base_s) + time.nsecs / 1e9,
        place = interface and interface.value or 0,
        sender = way .. "/" .. table.concat(sources, "/"),
        address = tostring(pinfo.net_dst),
        is_inbound = way == INBOUND,
    }
end

-- What is known of a datagram; at its first sight it is taken note of.
--
-- In the first of two passes tshark tells no fields of other protocols unless it was given a display filter. Then the
-- second pass takes note, in order as the first would have.
local function note_of(tvb, pinfo, packet)
    local key = pinfo.number .. "|" .. tvb:offset()
    local is_new = not known.notes[key] and pinfo.number >= last_frame
    if is_new and not packet.bad and not pinfo.in_error_pkt and frame_time() then
        last_frame = pinfo.number
        known:see(packet, sight_of(key, pinfo), udp_mesh.prefs.grace_us / 1e6, base_s)
    end
    return known.notes[key]
end

-- Shows one datagram, which the whole tvb is; returns what the info column says of it.
local function show_datagram(tvb, pinfo, tree, packet)
    local note = note_of(tvb, pinfo, packet)
    local item = tree:add(udp_mesh, tvb(), "udp_mesh")
    local texts, ways = {}, ""
    if tvb:len() >= wire.HEADER_BYTES then
        show.header(tvb, item)
        ways = show.ends(item, packet)
        show.note(item, note)
        texts = show.frames(tvb, pinfo, item, packet, note)
        if packet.is_sealed and not packet.bad then
            texts = { show.seal(tvb, item) }
        end
    end
    if packet.bad then
        texts[#texts + 1] = show.bad(tvb, item, packet)
    end
    return ways .. " " .. table.concat(texts, ", ")
end

function udp_mesh.dissector(tvb, pinfo, tree)
    local bytes, infos, at = tvb:len() > 0 and tvb:raw() or "", {}, 0
    if bytes:sub(1, 2) ~= "uM" then
        return 0
    end
    pinfo.cols.protocol = "udp_mesh"
    repeat
        local packet = wire.read(bytes:sub(at + 1))
        infos[#infos + 1] = show_datagram(tvb(at, packet.size):tvb(), pinfo, tree, packet)
        at = at + packet.size
    until at >= #bytes
    pinfo.cols.info = table.concat(infos, " | ")
    return at
end

udp_mesh:register_heuristic("udp", function(tvb, pinfo, tree)
    return tvb:len() > 0 and wire.is_datagram(tvb:raw()) and udp_mesh.dissector(tvb, pinfo, tree) > 0
end)

local ports = udp_mesh.prefs.ports
DissectorTable.get("udp.port"):add(ports, udp_mesh)

function udp_mesh.prefs_changed()
    if ports ~= udp_mesh.prefs.ports then
        DissectorTable.get("udp.port"):remove(ports, udp_mesh)
        ports = udp_mesh.prefs.ports
        DissectorTable.get("udp.port"):add(ports, udp_mesh)
    end
end
