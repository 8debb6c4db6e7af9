-- udp_mesh over raw Ethernet (docs/wire.md, Carriers): two bytes of length before the datagram, because short frames
-- are padded.
--
-- Others may use the same EtherType, which is for local experiments. So whoever comes later hands on what is not its
-- own to whoever was there before.

local wire = require "udp_mesh_wire"

local ETHERTYPE = 0x88B5

local carrier = Proto("udp_mesh_ethernet", "udp_mesh over Ethernet")
carrier.fields.length = ProtoField.uint16("udp_mesh_ethernet.length", "Datagram length", base.UNIT_STRING,
    { " byte", " bytes" })
carrier.fields.padding = ProtoField.bytes("udp_mesh_ethernet.padding", "Padding")
carrier.experts.length = ProtoExpert.new("udp_mesh_ethernet.expert.length", "Longer than the frame",
    expert.group.MALFORMED, expert.severity.ERROR)

local types = DissectorTable.get("ethertype")
local former = types:get_dissector(ETHERTYPE)

function carrier.dissector(tvb, pinfo, tree)
    if tvb:len() < 2 + wire.HEADER_BYTES or not wire.is_datagram(tvb:raw(2)) then
        return former and former:call(tvb, pinfo, tree) or 0
    end
    local length, room = tvb(0, 2):uint(), tvb:len() - 2
    local item = tree:add(carrier, tvb(0, 2))
    local length_item = item:add(carrier.fields.length, tvb(0, 2))
    if length > room then
        length_item:add_proto_expert_info(carrier.experts.length)
    elseif length < room then
        item:add(carrier.fields.padding, tvb(2 + length))
    end
    if length > 0 then
        Dissector.get("udp_mesh"):call(tvb(2, math.min(length, room)):tvb(), pinfo, tree)
    end
    return tvb:len()
end

types:add(ETHERTYPE, carrier)
