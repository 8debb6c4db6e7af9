-- Wireshark dissector of wnet: what its members send each other, EtherType 88b6. docs/wireshark.md is the manual.
--
-- wnet_wire.lua reads the bytes, wnet_conversations.lua follows frames from hop to hop. Sealed bodies stay closed:
-- Wireshark's Lua has no ChaCha20-Poly1305.

local wire = require "wnet_wire"
local conversations = require "wnet_conversations"
local items = require "tree_items"

local duration, generated = items.duration, items.generated

local ETHERTYPE = 0x88B6

local wnet = Proto("wnet", "wnet")
wnet.prefs.grace_us = Pref.uint("Grace of priority inversions (us)", 1000,
    "A frame that left a relay within this time after a more urgent one had arrived could not be called back")
local BYTES = { " byte", " bytes" }

local function field(kind, name, text, ...)
    return ProtoField[kind]("wnet." .. name, text, ...)
end

local f = {
    kind = field("uint8", "kind", "Kind", base.HEX, wire.KINDS),
    check = field("uint16", "check", "Check (CRC-16/CCITT)", base.HEX),
    bad = field("string", "bad", "Dropped as"),
    ack_wanted = field("bool", "ack_wanted", "Acknowledgement wanted", 8, nil, 0x01),
    attempt = field("uint8", "try", "Try", base.DEC, nil, 0x0E),
    hop_limit = field("uint8", "hop_limit", "Hop limit"),
    urgency = field("uint8", "urgency", "Urgency"),
    length = field("uint16", "length", "Length of the frame inside", base.UNIT_STRING, BYTES),
    link_sequence = field("uint16", "link_sequence", "Link sequence"),
    hops = field("uint8", "hops", "Next hops"),
    peer = field("ether", "hop.member", "Member of the next hop"),
    destinations = field("uint8", "hop.destinations", "Destinations"),
    destination = field("ether", "hop.destination", "Destination"),
    route_length = field("uint8", "route_length", "Nodes left to pass"),
    route = field("ether", "route", "Node to pass"),
    epoch = field("uint32", "epoch", "Source's epoch", base.HEX),
    sequence = field("uint32", "sequence", "Source's sequence number"),
    node = field("ether", "node", "Node"),
    member = field("uint8", "hello.member", "Member"),
    own_utilisation = field("double", "hello.own_utilisation", "Share of the time that it sends itself"),
    utilisation = field("double", "utilisation", "Share of the time that the channel is busy"),
    hello_sequence = field("uint16", "hello.sequence", "HELLO sequence number"),
    interval_ms = field("uint16", "hello.interval", "HELLO interval", base.UNIT_STRING, { " ms" }),
    interval_s = field("uint8", "tc.interval", "TC interval", base.UNIT_STRING, { " s" }),
    age = field("double", "tc.age", "Age", { " s" }),
    digest = field("uint32", "hello.digest", "Digest of all TCs", base.HEX),
    partial = field("bool", "hello.partial", "Leaves links out", 8, nil, 0x01),
    address = field("ipv4", "address", "Address"),
    group = field("ether", "group", "Multicast group"),
    neighbour = field("ether", "link.node", "Neighbour"),
    neighbour_epoch = field("uint32", "link.epoch", "Neighbour's epoch", base.HEX),
    peer_member = field("uint8", "link.peer_member", "Member of the neighbour", base.DEC, nil, 0xF0),
    own_member = field("uint8", "link.own_member", "Member of the sender", base.DEC, nil, 0x0F),
    usable = field("bool", "link.usable", "Usable", 8, nil, 0x80),
    mpr = field("bool", "link.mpr", "Multipoint relay", 8, nil, 0x40),
    link_id = field("uint8", "link.id", "Link id"),
    link_loss = field("double", "link.loss", "Loss", { "" }),
    link_snr = field("int8", "link.snr", "Signal to noise", base.UNIT_STRING, { " dB" }),
    link_rate = field("double", "link.rate", "Rate", { " bit/s" }),
    newest = field("uint16", "ack.newest", "Newest link sequence"),
    bits = field("uint32", "ack.bits", "Of the 32 before it", base.HEX),
    acked = field("uint16", "ack.sequence", "Acknowledges"),
    ack_try = field("uint8", "ack.try", "Try of the newest"),
    key_id = field("uint8", "seal.key_id", "Key id", base.HEX),
    counter = field("uint64", "seal.counter", "Counter"),
    seal_epoch = field("uint32", "seal.epoch", "Sender's epoch", base.HEX),
    sealed = field("bytes", "seal.body", "Encrypted body and tag"),
    first_seen_in = field("framenum", "first_seen_in", "First seen in", base.NONE, frametype.NONE),
    transit_time = field("relative_time", "transit_time", "Time since it was first seen"),
    retransmission = field("bool", "retransmission", "Sent to this hop before"),
    inversion = field("bool", "inversion", "Priority inversion"),
    inversion_urgency = field("uint8", "inversion.urgency", "Urgency of what waited at this relay"),
    inversion_done = field("framenum", "inversion.done_in", "Which left only in", base.NONE, frametype.NONE),
    inversion_waited = field("relative_time", "inversion.waited", "Had waited for"),
    acked_in = field("framenum", "acked_in", "Acknowledged in", base.NONE, frametype.ACK),
    acked_after = field("relative_time", "acked_after", "Acknowledged after"),
}
wnet.fields = f
wnet.experts.retry = ProtoExpert.new("wnet.expert.retransmission", "Retransmission to the next hop",
    expert.group.SEQUENCE, expert.severity.NOTE)
wnet.experts.inversion = ProtoExpert.new("wnet.expert.inversion", "Priority inversion at a relay",
    expert.group.SEQUENCE, expert.severity.WARN)
wnet.experts.bad = ProtoExpert.new("wnet.expert.bad", "Dropped by whoever receives it",
    expert.group.MALFORMED, expert.severity.ERROR)

local frame_time = Field.new("frame.time_epoch")
local interface_name = Field.new("frame.interface_name")
local direction = Field.new("frame.packet_flags_direction")
local INBOUND, OUTBOUND = 1, 2

-- Conversations of this file, the second of its first frame, and the last frame that was taken note of.
local known, base_s, last_frame

function wnet.init()
    known, base_s, last_frame = conversations.new(), nil, 0
end

-- Where and when a body was seen, in the terms of wnet_conversations.lua. netlab names interfaces NODE/INTERFACE.
local function sight_of(key, pinfo)
    local time, name, flow = frame_time().value, interface_name(), direction()
    base_s = base_s or time.secs
    local interface, way = name and name.value or "", flow and flow.value or 0
    return {
        key = key,
        frame = pinfo.number,
        t_s = (time.secs - base_s) + time.nsecs / 1e9,
        interface = interface,
        node = interface:match("^(.-)/") or interface,
        source = tostring(pinfo.dl_src),
        to = tostring(pinfo.dl_dst),
        is_inbound = way == INBOUND,
        is_outbound = way == OUTBOUND,
    }
end

-- What is known of a body; at its first sight it is taken note of, in the second pass if the first has no fields (see
-- udp_mesh.lua).
local function note_of(tvb, pinfo, body)
    local key = pinfo.number .. "|" .. tvb:offset()
    if not known.notes[key] and not body.bad and pinfo.number >= last_frame and frame_time() then
        last_frame = pinfo.number
        known:see(body, sight_of(key, pinfo), wnet.prefs.grace_us / 1e6)
    end
    return known.notes[key] or {}
end

local function add_info(tree, tvb, info)
    for position = 0, info.addresses - 1 do
        tree:add(f.address, tvb(info.addresses_at + 4 * position, 4))
    end
    for position = 0, info.groups - 1 do
        tree:add(f.group, tvb(info.groups_at + 6 * position, 6))
    end
end

-- Loss in 1/255, signal to noise in dB (-128: unknown), rate on a logarithmic scale (0: unknown).
local function add_attributes(tree, range)
    tree:add(f.link_loss, range(0, 1), range(0, 1):uint() / 255)
    if range(1, 1):int() ~= -128 then
        tree:add(f.link_snr, range(1, 1))
    end
    if range(2, 1):uint() > 0 then
        tree:add(f.link_rate, range(2, 1), 1000 * 2 ^ (range(2, 1):uint() / 8))
    end
end

local show = {}

show[wire.HELLO] = function(body, tvb, tree)
    tree:add(f.partial, tvb(1, 1))
    tree:add(f.check, tvb(2, 2))
    tree:add(f.member, tvb(4, 1))
    tree:add(f.own_utilisation, tvb(5, 1), tvb(5, 1):uint() / 255)
    tree:add(f.utilisation, tvb(6, 1), tvb(6, 1):uint() / 255)
    tree:add(f.node, tvb(7, 6))
    tree:add(f.epoch, tvb(13, 4))
    tree:add(f.hello_sequence, tvb(17, 2))
    tree:add(f.interval_ms, tvb(19, 2))
    tree:add(f.digest, tvb(21, 4))
    add_info(tree, tvb, body.info)
    for position = 0, body.info.links - 1 do
        local range = tvb(body.info.links_at + wire.HEARD_BYTES * position, wire.HEARD_BYTES)
        local item = tree:add(f.neighbour, range(0, 6))
        item:add(f.neighbour_epoch, range(6, 4))
        item:add(f.peer_member, range(10, 1))
        item:add(f.own_member, range(10, 1))
        item:add(f.usable, range(11, 1))
        item:add(f.mpr, range(11, 1))
        item:add(f.link_id, range(11, 1), range(11, 1):uint() % 16)
        add_attributes(item, range(12, 3))
        if range(15, 1):uint() ~= 255 then
            add_attributes(item:add(range(15, 3), "Outgoing"), range(15, 3))
        end
    end
    return string.format("HELLO of %s, %d links", tostring(tvb(7, 6):ether()), body.info.links)
end

show[wire.ACK] = function(body, tvb, tree)
    tree:add(f.ack_try, tvb(1, 1))
    tree:add(f.check, tvb(2, 2))
    tree:add(f.newest, tvb(4, 2))
    tree:add(f.bits, tvb(6, 4))
    for _, sequence in ipairs(body.sequences) do
        generated(tree, f.acked, sequence)
    end
    return "ACK " .. table.concat(body.sequences, ",")
end

show[wire.SEALED] = function(body, tvb, tree)
    tree:add(f.key_id, tvb(1, 1))
    tree:add(f.counter, tvb(2, 6))
    tree:add(f.seal_epoch, tvb(8, 4))
    tree:add(f.length, tvb(12, 2))
    tree:add(f.sealed, tvb(wire.SEAL_BYTES, body.size - wire.SEAL_BYTES))
    return string.format("sealed, key %02x", tvb(1, 1):uint())
end

local function add_tc(tc, tvb, tree)
    tree:add(f.node, tvb(6, 6))
    tree:add(f.utilisation, tvb(14, 1), tvb(14, 1):uint() / 255)
    tree:add(f.interval_s, tvb(15, 1))
    add_info(tree, tvb, tc.info)
    for position = 0, tc.info.links - 1 do
        local range = tvb(tc.info.links_at + wire.TC_LINK_BYTES * position, wire.TC_LINK_BYTES)
        local item = tree:add(f.neighbour, range(0, 6))
        item:add(f.link_id, range(6, 1))
        add_attributes(item, range(7, 3))
    end
end

local function add_list(body, tvb, tree)
    if body.kind == wire.ROUTED then
        tree:add(f.route_length, tvb(wire.HEAD_BYTES, 1))
        for at = wire.HEAD_BYTES + 1, body.tail_at - 6, 6 do
            tree:add(f.route, tvb(at, 6))
        end
    elseif body.tail_at > wire.HEAD_BYTES then
        tree:add(f.hops, tvb(wire.HEAD_BYTES, 1))
    end
    for _, hop in ipairs(body.hops) do
        local item = tree:add(f.peer, tvb(hop.at, 6))
        item:add(f.link_sequence, tvb(hop.at + 6, 2))
        if body.kind == wire.MULTICAST then
            item:add(f.destinations, tvb(hop.at + 8, 1))
        end
        for at = hop.at + 9, hop.at + hop.size - 6, 6 do
            item:add(f.destination, tvb(at, 6))
        end
    end
end

local function show_data(body, tvb, tree, pinfo, root)
    tree:add(f.ack_wanted, tvb(1, 1))
    local attempt = tree:add(f.attempt, tvb(1, 1))
    tree:add(f.hop_limit, tvb(2, 1))
    tree:add(f.urgency, tvb(3, 1))
    tree:add(f.check, tvb(4, 2))
    tree:add(f.length, tvb(6, 2))
    if body.kind == wire.TC then
        tree:add(f.age, tvb(8, 2), tvb(8, 2):uint() * wire.AGE_UNIT_S)
    else
        tree:add(f.link_sequence, tvb(8, 2))
    end
    if body.attempt > 0 then
        generated(tree, f.retransmission, true)
        attempt:add_proto_expert_info(wnet.experts.retry)
    end
    add_list(body, tvb, tree)
    local again = body.attempt > 0 and " [retransmission]" or ""
    local text = string.format("%s p%d%s", wire.KINDS[body.kind], body.urgency, again)
    if body.kind == wire.PROBE then
        return text
    end
    local tail = tvb(body.tail_at, body.size - body.tail_at)
    tree:add(f.epoch, tail(0, 4))
    tree:add(f.sequence, tail(4, 4))
    text = string.format("%s #%d", text, tail(4, 4):uint())
    local inner = tail(wire.ORIGIN_BYTES):tvb()
    if body.tc then
        add_tc(body.tc, inner, tree)
    elseif body.kind ~= wire.TC then
        Dissector.get("eth_withoutfcs"):call(inner, pinfo, root)
    end
    return text
end

local function add_note(tree, note)
    generated(tree, f.first_seen_in, note.first_seen_in)
    generated(tree, f.transit_time, note.transit_s and duration(note.transit_s))
    generated(tree, f.acked_in, note.acked_in)
    generated(tree, f.acked_after, note.acked_after_s and duration(note.acked_after_s))
    local inversion = note.inversion
    if inversion then
        generated(tree, f.inversion, true):add_proto_expert_info(wnet.experts.inversion)
        generated(tree, f.inversion_urgency, inversion.urgency)
        generated(tree, f.inversion_waited, duration(inversion.waited_s))
        generated(tree, f.inversion_done, inversion.done_in)
    end
end

local function add_bodies(body, tvb, pinfo, root, show_body)
    local texts = {}
    for position, part in ipairs(body.parts) do
        texts[position] = show_body(tvb(part.at, part.size):tvb(), pinfo, root)
    end
    return table.concat(texts, " | ")
end

-- Shows one body; returns what the info column says of it. The frame inside goes into `root`, beside it.
local function show_body(tvb, pinfo, root)
    local body = wire.read(tvb:raw())
    local note = note_of(tvb, pinfo, body)
    local tree = root:add(wnet, tvb(0, body.size), "wnet")
    tree:add(f.kind, tvb(0, 1))
    if body.bad then
        generated(tree, f.bad, body.bad):add_proto_expert_info(wnet.experts.bad)
    end
    if body.bad and not body.tail_at then
        return "[" .. body.bad .. "]"
    end
    local text
    if body.kind == wire.AGGREGATE then
        text = add_bodies(body, tvb, pinfo, root, show_body)
    else
        text = (show[body.kind] or show_data)(body, tvb, tree, pinfo, root)
    end
    tree:append_text(", " .. text)
    add_note(tree, note)
    return text
end

local types = DissectorTable.get("ethertype")
local former = types:get_dissector(ETHERTYPE)

function wnet.dissector(tvb, pinfo, tree)
    if tvb:len() == 0 or not wire.KINDS[tvb(0, 1):uint()] then
        return former and former:call(tvb, pinfo, tree) or 0
    end
    pinfo.cols.protocol = "wnet"
    local text = show_body(tvb, pinfo, tree)
    pinfo.cols.info = text
    return tvb:len()
end

types:add(ETHERTYPE, wnet)
