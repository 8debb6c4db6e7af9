-- Wireshark dissector of udp_mesh (docs/wire.md): fields, tree and expert infos. docs/wireshark.md is its manual.
--
-- udp_mesh_wire.lua reads the bytes, udp_mesh_conversations.lua knows what datagrams have to do with each other;
-- udp_mesh_ethernet.lua and udp_mesh_serial.lua call this dissector for other carriers than UDP. For payloads there is a
-- dissector table by topic, udp_mesh.topic.

local wire = require "udp_mesh_wire"
local conversations = require "udp_mesh_conversations"

local udp_mesh = Proto("udp_mesh", "udp_mesh")
local topics = DissectorTable.new("udp_mesh.topic", "udp_mesh topic", ftypes.STRING)

udp_mesh.prefs.ports = Pref.range("UDP ports", "8700", "Ports on which everything that begins as udp_mesh is taken for it", 65535)
udp_mesh.prefs.grace_us = Pref.uint("Grace of priority inversions (us)", 1000,
    "A fragment that left within this time after a more urgent message was published could not be called back. "
    .. "To judge as netlab does, add the time that a full frame takes on the link: 12000 at 1 Mbit/s")

local CONFIRMS = { [0] = "answered", [1] = "nobody subscribed" }
local MICROSECONDS, BYTES = { " µs" }, { " byte", " bytes" }

local function field(kind, name, text, ...)
    return ProtoField[kind]("udp_mesh." .. name, text, ...)
end

local f = {
    magic = field("string", "magic", "Magic"),
    version = field("uint8", "version", "Version"),
    flags = field("uint8", "flags", "Flags", base.HEX),
    unnumbered = field("bool", "flags.unnumbered", "Unnumbered (never acknowledged)", 8, nil, 0x01),
    ack_now = field("bool", "flags.ack_now", "Acknowledge at once", 8, nil, 0x02),
    sealed = field("bool", "flags.sealed", "Sealed", 8, nil, 0x04),
    bridged = field("bool", "flags.bridged", "Bridged", 8, nil, 0x08),
    epoch = field("uint64", "epoch", "Sender epoch", base.HEX),
    destination_tag = field("uint32", "destination_tag", "Destination tag", base.HEX),
    number = field("uint64", "packet_number", "Packet number"),
    key_id = field("uint8", "seal.key_id", "Key id", base.HEX),
    series = field("uint8", "seal.series", "Series"),
    seal_number = field("uint64", "seal.number", "Sealed datagram number"),
    seal_frames = field("bytes", "seal.frames", "Encrypted frames"),
    seal_tag = field("bytes", "seal.tag", "Authentication tag"),
    frame = field("uint8", "frame", "Frame type", base.DEC, wire.TYPES),
    data_flags = field("uint8", "data.flags", "Flags", base.HEX),
    has_envelope = field("bool", "data.envelope", "Payload begins with an envelope", 8, nil, 0x01),
    priority = field("uint8", "priority", "Priority"),
    length = field("uint16", "data.length", "Length", base.UNIT_STRING, BYTES),
    message_id = field("uint64", "message_id", "Message id"),
    index = field("uint16", "fragment_index", "Fragment index"),
    count = field("uint16", "fragment_count", "Fragment count"),
    topic_length = field("uint8", "topic_length", "Topic length"),
    topic = field("string", "topic", "Topic", base.UNICODE),
    payload = field("bytes", "payload", "Payload of the fragment"),
    largest = field("uint64", "ack.largest", "Largest"),
    received_us = field("uint32", "ack.received", "Received (receiver's clock)", base.UNIT_STRING, MICROSECONDS),
    delay_us = field("uint32", "ack.delay", "Delay", base.UNIT_STRING, MICROSECONDS),
    first_range = field("uint16", "ack.first_range", "First range"),
    further = field("uint8", "ack.further", "Further ranges"),
    range = field("string", "ack.range", "Range"),
    gap = field("uint16", "ack.gap", "Gap"),
    range_length = field("uint16", "ack.length", "Length"),
    interval = field("uint16", "hello.interval", "Beacon interval", base.UNIT_STRING, { " ms" }),
    floor = field("uint64", "floor", "Floor (messages below it are settled)"),
    tag_count = field("uint8", "tag_count", "Tags"),
    name_length = field("uint8", "hello.name_length", "Name length"),
    heard = field("uint32", "hello.heard", "Heard", base.HEX),
    name = field("string", "hello.name", "Name", base.UNICODE),
    wanted = field("uint32", "probe.tag", "Looks for", base.HEX),
    purged = field("uint64", "purged", "Purged message id"),
    backlog = field("uint8", "backlog.priority", "Priority of what waits"),
    link_number = field("uint8", "link.number", "Carrier number"),
    link_mtu = field("uint16", "link.mtu", "Longest datagram", base.UNIT_STRING, BYTES),
    link_rate = field("uint32", "link.rate", "Rate", base.UNIT_STRING, { " bit/s" }),
    rounds = field("uint8", "link.rounds", "Rounds"),
    reached = field("uint32", "link.tag", "Reaches", base.HEX),
    features = field("uint8", "envelope.features", "Features", base.HEX),
    stored = field("bool", "envelope.stored", "Stored", 8, nil, 0x01),
    confirms = field("bool", "envelope.confirms", "Confirms", 8, nil, 0x02),
    asks = field("bool", "envelope.asks", "Request", 8, nil, 0x04),
    answers = field("bool", "envelope.answers", "Response", 8, nil, 0x08),
    compressed = field("bool", "envelope.compressed", "Compressed", 8, nil, 0x10),
    store = field("uint64", "envelope.store", "Store", base.HEX),
    sequence = field("uint64", "envelope.sequence", "Number in the store"),
    store_floor = field("uint64", "envelope.floor", "Floor in the store"),
    request = field("uint64", "envelope.request", "Request", base.HEX),
    response = field("uint64", "envelope.response", "Response to", base.HEX),
    status = field("uint8", "envelope.status", "Status", base.DEC, CONFIRMS),
    original_bytes = field("uint32", "envelope.original_bytes", "Size once decompressed", base.UNIT_STRING, BYTES),
    message = field("bytes", "message", "Message"),
    message_length = field("uint32", "message.length", "Message length", base.UNIT_STRING, BYTES),
    -- Known from other datagrams.
    sender = field("string", "sender", "Sender"),
    receiver = field("string", "receiver", "Receiver"),
    bad = field("string", "bad", "Dropped as"),
    first_seen_in = field("framenum", "first_seen_in", "First seen in", base.NONE, frametype.NONE),
    transit_time = field("relative_time", "transit_time", "Time since it was first seen"),
    duplicate_of = field("framenum", "duplicate_of", "Duplicate of", base.NONE, frametype.DUP_ACK),
    acked_in = field("framenum", "acked_in", "Acknowledged in", base.NONE, frametype.ACK),
    acked_after = field("relative_time", "acked_after", "Acknowledged after"),
    acks_frame = field("framenum", "ack.frame", "Acknowledges frame", base.NONE, frametype.ACK),
    response_time = field("relative_time", "ack.response_time", "Time since the largest was sent"),
    answered_in = field("framenum", "answered_in", "Answered in", base.NONE, frametype.RESPONSE),
    answer_to = field("framenum", "answer_to", "Answers the probe in", base.NONE, frametype.REQUEST),
    answer_time = field("relative_time", "answer_time", "Time since the probe"),
    retransmission = field("bool", "retransmission", "Retransmission"),
    retransmission_of = field("framenum", "retransmission_of", "First sent in", base.NONE, frametype.NONE),
    inversion = field("bool", "inversion", "Priority inversion"),
    inversion_id = field("uint64", "inversion.message_id", "More urgent message that waited"),
    inversion_priority = field("uint8", "inversion.priority", "Its priority"),
    inversion_done = field("framenum", "inversion.done_in", "Which left as a whole only in", base.NONE, frametype.NONE),
    inversion_waited = field("relative_time", "inversion.waited", "Had waited for"),
    reassembled_in = field("framenum", "reassembled_in", "Reassembled in", base.NONE, frametype.NONE),
    fragment = field("framenum", "fragment", "Fragment", base.NONE, frametype.NONE),
    message_time = field("relative_time", "message.time", "Time from the first fragment to the last"),
    response_in = field("framenum", "response_in", "Response in", base.NONE, frametype.RESPONSE),
    request_in = field("framenum", "request_in", "Request in", base.NONE, frametype.REQUEST),
    request_time = field("relative_time", "request_time", "Time since the request"),
}
udp_mesh.fields = f

local function expert_info(name, text, group, severity)
    return ProtoExpert.new("udp_mesh.expert." .. name, text, group, severity)
end

local e = {
    bad = expert_info("bad", "Dropped by whoever receives it", expert.group.MALFORMED, expert.severity.ERROR),
    retransmission = expert_info("retransmission", "Retransmission", expert.group.SEQUENCE, expert.severity.NOTE),
    duplicate = expert_info("duplicate", "Duplicated on the way", expert.group.SEQUENCE, expert.severity.NOTE),
    inversion = expert_info("inversion", "Priority inversion", expert.group.SEQUENCE, expert.severity.WARN),
    contradiction = expert_info("contradiction", "Contradicts the message's other fragments",
        expert.group.PROTOCOL, expert.severity.WARN),
    envelope = expert_info("envelope", "Envelope cannot be read: the message is dropped",
        expert.group.MALFORMED, expert.severity.ERROR),
    purged = expert_info("purged", "The receiver gave up a partial message", expert.group.SEQUENCE, expert.severity.NOTE),
    restart = expert_info("restart", "The node was restarted: its epoch is new", expert.group.SEQUENCE,
        expert.severity.NOTE),
}
udp_mesh.experts = e

local frame_time = Field.new("frame.time_epoch")
local interface_id = Field.new("frame.interface_id")
local direction = Field.new("frame.packet_flags_direction")
local link_source = Field.new("eth.src")
local INBOUND = 1

-- Conversations of this file, the second of its first datagram, and the last frame that was taken note of.
local known, base_s, last_frame

function udp_mesh.init()
    known, base_s, last_frame = conversations.new(), nil, 0
end

local function duration(seconds)
    local sign = seconds < 0 and -1 or 1
    local nanoseconds = math.floor(sign * seconds * 1e9 + 0.5)
    return NSTime.new(sign * math.floor(nanoseconds / 1e9), sign * (nanoseconds % 1e9))
end

local function generated(tree, what, value)
    if value ~= nil then
        local item = tree:add(what, value)
        item:set_generated()
        return item
    end
end

local function plain(number)
    return string.format("%d", number)
end

local function node_name(tag)
    return tag == 0 and "all" or known.names[tag] or string.format("%08x", tag)
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
        place = (interface and interface.value or 0) .. "/" .. #sources,
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

local function add_tags(tree, what, range, tags, add_name)
    for position, tag in ipairs(tags) do
        local item = tree:add(what, range(4 * position - 4, 4))
        if add_name then
            item:append_text(" (" .. (tag == 0 and "everybody" or node_name(tag)) .. ")")
        end
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
    local fields = { floor = f.store_floor }
    for name, place in pairs(envelope.places) do
        item:add(fields[name] or f[name], range(place[1], place[2]))
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
    local item = tree:add(udp_mesh, tvb(), string.format("Reassembled message (%d bytes, %d fragments)", #payload, message.count))
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
local show = {}

show[wire.DATA] = function(frame, range, tree, pinfo, note)
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

show[wire.ACK] = function(frame, range, tree, _, _, note)
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

show[wire.HELLO] = function(frame, range, tree, _, _, note)
    tree:add(f.interval, range(1, 2))
    tree:add(f.floor, range(3, 6))
    tree:add(f.tag_count, range(9, 1))
    tree:add(f.name_length, range(10, 1))
    if #frame.tags > 0 then
        add_tags(tree, f.heard, range(11, 4 * #frame.tags), frame.tags, true)
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

show[wire.PROBE] = function(frame, range, tree, _, _, note)
    tree:add(f.tag_count, range(1, 1))
    local names = {}
    if #frame.tags > 0 then
        add_tags(tree, f.wanted, range(2), frame.tags, true)
    end
    for position, tag in ipairs(frame.tags) do
        names[position] = tag == 0 and "everybody" or node_name(tag)
    end
    generated(tree, f.answered_in, note and note.answered_in)
    local text = table.concat(names, ",")
    tree:append_text(" " .. text)
    return "PROBE " .. text
end

show[wire.PING] = function()
    return "PING"
end

show[wire.FLOOR] = function(frame, range, tree)
    tree:add(f.floor, range(1, 6))
    return "FLOOR " .. plain(frame.message_id)
end

show[wire.PURGED] = function(frame, range, tree)
    tree:add(f.purged, range(1, 6)):add_proto_expert_info(e.purged)
    return "PURGED " .. plain(frame.message_id)
end

show[wire.BACKLOG] = function(frame, range, tree)
    tree:add(f.backlog, range(1, 1))
    return "BACKLOG p" .. frame.priority
end

show[wire.LINK] = function(frame, range, tree)
    tree:add(f.link_number, range(1, 1))
    tree:add(f.link_mtu, range(2, 2))
    tree:add(f.link_rate, range(4, 4))
    tree:add(f.rounds, range(8, 1))
    tree:add(f.tag_count, range(9, 1))
    if #frame.tags > 0 then
        add_tags(tree, f.reached, range(10), frame.tags, true)
    end
    return "LINK " .. #frame.tags .. " nodes"
end

local function add_header(tvb, tree)
    tree:add(f.magic, tvb(0, 2))
    tree:add(f.version, tvb(2, 1))
    local flags = tree:add(f.flags, tvb(3, 1))
    for _, bit in ipairs({ f.unnumbered, f.ack_now, f.sealed, f.bridged }) do
        flags:add(bit, tvb(3, 1))
    end
    tree:add(f.epoch, tvb(4, 8))
    tree:add(f.destination_tag, tvb(12, 4))
    tree:add(f.number, tvb(16, 6))
end

-- What is encrypted stays so: opening it needs ChaCha20-Poly1305 and the team's key.
local function add_seal(tvb, tree)
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

local function add_datagram_note(tree, note)
    if note.duplicate_of then
        generated(tree, f.duplicate_of, note.duplicate_of):add_proto_expert_info(e.duplicate)
    end
    generated(tree, f.first_seen_in, note.first_seen_in)
    generated(tree, f.transit_time, note.transit_s and duration(note.transit_s))
    generated(tree, f.acked_in, note.acked_in)
    generated(tree, f.acked_after, note.acked_after_s and duration(note.acked_after_s))
end

local function add_frames(tvb, pinfo, tree, packet, note)
    local texts = {}
    for position, frame in ipairs(packet.frames) do
        local range = tvb(frame.at, frame.size)
        local item = tree:add(range, wire.TYPES[frame.kind])
        item:add(f.frame, range(0, 1))
        texts[position] = show[frame.kind](frame, range, item, pinfo, note and note.fragments[position], note)
    end
    return texts
end

local function add_bad(tvb, pinfo, tree, packet)
    local item = generated(tree, f.bad, packet.bad)
    local is_cut = tvb:len() < tvb:reported_len()
    item:add_proto_expert_info(e.bad, "Dropped by whoever receives it: " .. packet.bad
        .. (is_cut and " (or is it the capture that is cut?)" or ""))
    return "[" .. packet.bad .. "]"
end

-- Shows one datagram, which the whole tvb is.
local function show_datagram(tvb, pinfo, tree, packet)
    local note = note_of(tvb, pinfo, packet)
    local item = tree:add(udp_mesh, tvb(), "udp_mesh")
    local texts, ways = {}, ""
    if tvb:len() >= wire.HEADER_BYTES then
        add_header(tvb, item)
        ways = node_name(packet.tag) .. " → " .. node_name(packet.destination_tag)
        generated(item, f.sender, node_name(packet.tag))
        generated(item, f.receiver, node_name(packet.destination_tag))
        item:append_text(", " .. ways .. ", packet " .. plain(packet.number))
        if note then
            add_datagram_note(item, note)
        end
        texts = add_frames(tvb, pinfo, item, packet, note)
        if packet.is_sealed and not packet.bad then
            texts[#texts + 1] = add_seal(tvb, item)
        end
    end
    if packet.bad then
        texts[#texts + 1] = add_bad(tvb, pinfo, item, packet)
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
