-- The tree of each frame of udp_mesh, and what the info column says of it.

local wire = require "udp_mesh_wire"
local fields = require "udp_mesh_fields"
local conversations = require "udp_mesh_conversations"
local items = require "tree_items"

local duration, generated = items.duration, items.generated
local f, e = fields.fields, fields.experts
local show = {
    names = {}, -- of nodes, by tag; the dissector sets it for each file
}

local function plain(number)
    return string.format("%d", number)
end

local function node_name(tag)
    return tag == 0 and "all" or show.names[tag] or string.format("%08x", tag)
end

local function wanted_name(tag)
    return tag == 0 and "everybody" or node_name(tag)
end

local function add_tags(tree, what, range, tags)
    for position, tag in ipairs(tags) do
        tree:add(what, range(4 * position - 4, 4)):append_text(" (" .. wanted_name(tag) .. ")")
    end
end

local function add_envelope(tree, range, payload)
    local envelope = wire.read_envelope(payload)
    if not envelope then
        tree:add_proto_expert_info(e.envelope)
        return 0
    end
    local item = tree:add(range(0, envelope.size), "Envelope")
    local features = item:add(f.features, range(0, 1))
    for _, bit in ipairs({ "stored", "confirms", "asks", "answers", "compressed" }) do
        features:add(f[bit], range(0, 1))
    end
    for name, place in pairs(envelope.places) do
        item:add(name == "floor" and f.store_floor or f[name], range(place[1], place[2]))
    end
    return envelope.size
end

-- Hands a whole message to whoever knows its topic, or netlab's traffic, or shows its bytes.
local function add_message(tvb, pinfo, tree, message)
    local size = tvb:len()
    generated(tree, f.message_length, size)
    local at = message.flags == 1 and size > 0 and add_envelope(tree, tvb(), tvb:raw()) or 0
    if at >= size then
        return
    end
    local rest = tvb(at):tvb()
    local topics = DissectorTable.get("udp_mesh.topic")
    if message.topic and topics:get_dissector(message.topic) then
        topics:try(message.topic, rest, pinfo, tree)
    elseif rest:len() >= 4 and rest:raw(0, 4) == "NLT1" and pcall(Dissector.get, "netlab_traffic") then
        Dissector.get("netlab_traffic"):call(rest, pinfo, tree)
    else
        tree:add(f.message, rest())
    end
end

local function add_reassembled(pinfo, tree, passage)
    local message = passage.message
    local payload = conversations.payload(message)
    if not payload then
        return
    end
    local tvb = ByteArray.new(payload, true):tvb("Reassembled message")
    local text = string.format("Reassembled message: %d bytes, %d fragments", #payload, message.count)
    local item = tree:add(tvb(), text)
    for index = 0, message.count - 1 do
        generated(item, f.fragment, passage.frames[index] and passage.frames[index].frame)
    end
    generated(item, f.message_time, duration(passage.took_s))
    add_message(tvb, pinfo, item, message)
end

local function add_fragment_note(pinfo, tree, note)
    if note.is_contradiction then
        tree:add_proto_expert_info(e.contradiction)
    end
    if note.retransmission_of then
        generated(tree, f.retransmission, true):add_proto_expert_info(e.retransmission)
        generated(tree, f.retransmission_of, note.retransmission_of)
    end
    local inversion = note.inversion
    if inversion then
        generated(tree, f.inversion, true):add_proto_expert_info(e.inversion)
        generated(tree, f.inversion_id, UInt64(inversion.message.id))
        generated(tree, f.inversion_priority, inversion.message.priority)
        generated(tree, f.inversion_waited, duration(inversion.waited_s))
        generated(tree, f.inversion_done, inversion.done_in)
    end
    generated(tree, f.response_in, note.response_in)
    generated(tree, f.request_in, note.request_in)
    generated(tree, f.request_time, note.request_after_s and duration(note.request_after_s))
    local passage = note.passage
    if passage and passage.message.count > 1 then
        if note.is_last then
            add_reassembled(pinfo, tree, passage)
        else
            generated(tree, f.reassembled_in, passage.done_in)
        end
    end
end

-- One function per frame type: adds its fields to the tree and returns what the info column says of it.
local show_frame = {}

show_frame[wire.DATA] = function(frame, range, tree, pinfo, note)
    tree:add(f.data_flags, range(1, 1)):add(f.has_envelope, range(1, 1))
    tree:add(f.priority, range(2, 1))
    tree:add(f.length, range(3, 2))
    tree:add(f.message_id, range(5, 6))
    tree:add(f.index, range(11, 2))
    tree:add(f.count, range(13, 2))
    local topic = note and note.message and note.message.topic
    if frame.topic then
        tree:add(f.topic_length, range(15, 1))
        tree:add(f.topic, range(16, frame.topic_bytes - 1))
        topic = frame.topic
    else
        generated(tree, f.topic, topic)
    end
    local payload_at = wire.DATA_BYTES + frame.topic_bytes
    local text = string.format("DATA %s #%s %d/%d p%d", topic or "?", plain(frame.message_id), frame.index + 1,
        frame.count, frame.priority)
    tree:append_text(string.format(" %s, message %s, fragment %d/%d, priority %d, %d bytes", topic or "",
        plain(frame.message_id), frame.index + 1, frame.count, frame.priority, #frame.payload))
    if #frame.payload > 0 then
        tree:add(f.payload, range(payload_at))
    end
    if frame.count == 1 and #frame.payload > 0 then
        add_message(range(payload_at):tvb(), pinfo, tree, { flags = frame.flags, topic = frame.topic })
    end
    if note then
        add_fragment_note(pinfo, tree, note)
        if note.retransmission_of then
            text = text .. " [retransmission]"
        end
        if note.inversion then
            text = text .. " [inversion]"
        end
    end
    return text
end

local function range_text(pair)
    return pair[1] == pair[2] and plain(pair[1]) or plain(pair[1]) .. "-" .. plain(pair[2])
end

show_frame[wire.ACK] = function(frame, range, tree, _, _, note)
    tree:add(f.largest, range(1, 6))
    tree:add(f.received_us, range(7, 4))
    tree:add(f.delay_us, range(11, 4))
    tree:add(f.first_range, range(15, 2))
    tree:add(f.further, range(17, 1))
    local texts = {}
    for position, pair in ipairs(frame.ranges) do
        texts[position] = range_text(pair)
        local place = position == 1 and range(15, 2) or range(14 + 4 * (position - 1), 4)
        local item = tree:add(f.range, place, texts[position])
        item:set_generated()
        if position > 1 then
            item:add(f.gap, place(0, 2))
            item:add(f.range_length, place(2, 2))
        end
    end
    if note then
        for _, number in ipairs(note.acks or {}) do
            generated(tree, f.acks_frame, number)
        end
        generated(tree, f.response_time, note.largest_after_s and duration(note.largest_after_s))
    end
    local text = table.concat(texts, ",")
    tree:append_text(" " .. text)
    return "ACK " .. text
end

show_frame[wire.HELLO] = function(frame, range, tree, _, _, note)
    tree:add(f.interval, range(1, 2))
    tree:add(f.floor, range(3, 6))
    tree:add(f.tag_count, range(9, 1))
    tree:add(f.name_length, range(10, 1))
    if #frame.tags > 0 then
        add_tags(tree, f.heard, range(11, 4 * #frame.tags), frame.tags)
    end
    tree:add(f.name, range(11 + 4 * #frame.tags))
    if note then
        if note.is_restart then
            tree:add_proto_expert_info(e.restart)
        end
        generated(tree, f.answer_to, note.answer_to)
        generated(tree, f.answer_time, note.answer_after_s and duration(note.answer_after_s))
    end
    tree:append_text(" " .. frame.name)
    return "HELLO " .. frame.name
end

show_frame[wire.PROBE] = function(frame, range, tree, _, _, note)
    tree:add(f.tag_count, range(1, 1))
    local names = {}
    if #frame.tags > 0 then
        add_tags(tree, f.wanted, range(2), frame.tags)
    end
    for position, tag in ipairs(frame.tags) do
        names[position] = wanted_name(tag)
    end
    generated(tree, f.answered_in, note and note.answered_in)
    local text = table.concat(names, ",")
    tree:append_text(" " .. text)
    return "PROBE " .. text
end

show_frame[wire.PING] = function()
    return "PING"
end

show_frame[wire.FLOOR] = function(frame, range, tree)
    tree:add(f.floor, range(1, 6))
    return "FLOOR " .. plain(frame.message_id)
end

show_frame[wire.PURGED] = function(frame, range, tree)
    tree:add(f.purged, range(1, 6)):add_proto_expert_info(e.purged)
    return "PURGED " .. plain(frame.message_id)
end

show_frame[wire.BACKLOG] = function(frame, range, tree)
    tree:add(f.backlog, range(1, 1))
    return "BACKLOG p" .. frame.priority
end

show_frame[wire.LINK] = function(frame, range, tree)
    tree:add(f.link_number, range(1, 1))
    tree:add(f.link_mtu, range(2, 2))
    tree:add(f.link_rate, range(4, 4))
    tree:add(f.rounds, range(8, 1))
    tree:add(f.tag_count, range(9, 1))
    if #frame.tags > 0 then
        add_tags(tree, f.reached, range(10), frame.tags)
    end
    return "LINK " .. #frame.tags .. " nodes"
end

function show.header(tvb, tree)
    tree:add(f.magic, tvb(0, 2))
    tree:add(f.version, tvb(2, 1))
    local flags = tree:add(f.flags, tvb(3, 1))
    for _, bit in ipairs({ f.unnumbered, f.ack_now, f.sealed, f.bridged, f.ack_later }) do
        flags:add(bit, tvb(3, 1))
    end
    tree:add(f.epoch, tvb(4, 8))
    tree:add(f.destination_tag, tvb(12, 4))
    tree:add(f.number, tvb(16, 6))
end

-- Of a sealed datagram: what is encrypted stays so: opening it needs ChaCha20-Poly1305 and the team's key.
function show.seal(tvb, tree)
    local sealed_bytes = tvb:len() - wire.CLEAR_BYTES - wire.TAG_BYTES
    tree:add(f.key_id, tvb(22, 1))
    tree:add(f.series, tvb(23, 1))
    tree:add(f.seal_number, tvb(24, 6))
    if sealed_bytes > 0 then
        tree:add(f.seal_frames, tvb(wire.CLEAR_BYTES, sealed_bytes))
    end
    tree:add(f.seal_tag, tvb(wire.CLEAR_BYTES + sealed_bytes))
    return string.format("sealed, key %02x, datagram %s", tvb(22, 1):uint(), tostring(tvb(24, 6):uint64()))
end

-- What is known of a datagram from others; nil if nothing is.
function show.note(tree, note)
    if not note then
        return
    end
    if note.duplicate_of then
        generated(tree, f.duplicate_of, note.duplicate_of):add_proto_expert_info(e.duplicate)
    end
    generated(tree, f.first_seen_in, note.first_seen_in)
    generated(tree, f.transit_time, note.transit_s and duration(note.transit_s))
    generated(tree, f.acked_in, note.acked_in)
    generated(tree, f.acked_after, note.acked_after_s and duration(note.acked_after_s))
end

-- Returns what the info column says of the frames.
function show.frames(tvb, pinfo, tree, packet, note)
    local texts = {}
    for position, frame in ipairs(packet.frames) do
        local range = tvb(frame.at, frame.size)
        local item = tree:add(range, wire.TYPES[frame.kind])
        item:add(f.frame, range(0, 1))
        texts[position] = show_frame[frame.kind](frame, range, item, pinfo, note and note.fragments[position], note)
    end
    return texts
end

function show.bad(tvb, tree, packet)
    local item = generated(tree, f.bad, packet.bad)
    local is_cut = tvb:len() < tvb:reported_len()
    item:add_proto_expert_info(e.bad, "Dropped by whoever receives it: " .. packet.bad
        .. (is_cut and " (or is it the capture that is cut?)" or ""))
    return "[" .. packet.bad .. "]"
end

-- Who sends to whom, and under which number.
function show.ends(tree, packet)
    local sender, receiver = node_name(packet.tag), node_name(packet.destination_tag)
    generated(tree, f.sender, sender)
    generated(tree, f.receiver, receiver)
    local ways = sender .. " → " .. receiver
    tree:append_text(", " .. ways .. ", packet " .. plain(packet.number))
    return ways
end

return show
