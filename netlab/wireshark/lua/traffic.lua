-- What netlab's traffic processes put first into every payload (netlab/lab/traffic.py): publication, sequence number
-- and the time of the publish call. Transports call it by its name, netlab_traffic, with a whole message.

local HEADER_BYTES = 18

local traffic = Proto("netlab_traffic", "netlab traffic")
local f = traffic.fields
f.magic = ProtoField.string("netlab_traffic.magic", "Magic")
f.publication = ProtoField.uint16("netlab_traffic.publication", "Publication")
f.sequence = ProtoField.uint32("netlab_traffic.sequence", "Sequence number")
f.published = ProtoField.absolute_time("netlab_traffic.published", "Published at", base.UTC)
f.latency = ProtoField.relative_time("netlab_traffic.latency", "Time since the publish call")
f.filling = ProtoField.bytes("netlab_traffic.filling", "Filling")

local frame_time = Field.new("frame.time_epoch")
local NS_PER_S = UInt64(1000000000)

function traffic.dissector(tvb, _, tree)
    if tvb:len() < HEADER_BYTES or tvb:raw(0, 4) ~= "NLT1" then
        return 0
    end
    local item = tree:add(traffic, tvb())
    item:add(f.magic, tvb(0, 4))
    item:add_le(f.publication, tvb(4, 2))
    item:add_le(f.sequence, tvb(6, 4))
    local published_ns = tvb(10, 8):le_uint64()
    local published = NSTime.new((published_ns / NS_PER_S):tonumber(), (published_ns % NS_PER_S):tonumber())
    item:add(f.published, tvb(10, 8), published)
    item:add(f.latency, frame_time().value - published):set_generated()
    if tvb:len() > HEADER_BYTES then
        item:add(f.filling, tvb(HEADER_BYTES))
    end
    item:append_text(string.format(", publication %d #%d", tvb(4, 2):le_uint(), tvb(6, 4):le_uint()))
    return tvb:len()
end
