-- What wnet's frames have to do with each other: followed over hops, acknowledged, overtaken. Nothing of Wireshark.
--
-- Told each sound body once, in the order of the capture, it keeps what is to be shown with it. A frame of data is
-- known by the key of its tail, which no hop changes.

local wire = require "wnet_wire"

local Conversations = {}
Conversations.__index = Conversations

local function new()
    return setmetatable({
        notes = {}, -- by the key of a sight: what to show
        first_sights = {}, -- by the key of a tail, anywhere
        waiting = {}, -- what waits for an acknowledgement, by interface, sender, neighbour and link sequence
        arrivals = {}, -- what a node is to pass on, by node and tail
        departures = {}, -- what left a node for one neighbour, in order
    }, Conversations)
end

local function joined(...)
    return table.concat({ ... }, "|")
end

local function colons(mac)
    return (mac:gsub(".", function(byte)
        return string.format("%02x:", byte:byte())
    end):sub(1, -2))
end

local function is_unicast(body)
    return body.kind == wire.UNICAST or body.kind == wire.ROUTED
end

-- Who is asked to acknowledge what: pairs of the neighbour's address and the link sequence.
local function asked(body, sight)
    if is_unicast(body) or body.kind == wire.PROBE then
        return { { sight.to, body.sequence } }
    end
    local neighbours = {}
    for position, hop in ipairs(body.hops or {}) do
        neighbours[position] = { colons(hop.peer), hop.sequence }
    end
    return neighbours
end

-- Takes a body that was seen. `sight`: key (of the notes), frame (number), t_s, interface, node (whose interface),
-- source and to (of the link layer, as text), is_inbound and is_outbound (both false where nobody knows).
function Conversations:see(body, sight, grace_s)
    local note = { frame = sight.frame, t_s = sight.t_s }
    self.notes[sight.key] = note
    if body.kind == wire.ACK then
        self:_acknowledge(body, sight)
    end
    for _, neighbour in ipairs(asked(body, sight)) do
        self.waiting[joined(sight.interface, sight.source, neighbour[1], neighbour[2])] = note
    end
    if body.key and #body.key > 0 then
        local first = self.first_sights[body.key]
        self.first_sights[body.key] = first or note
        if first then
            note.first_seen_in, note.transit_s = first.frame, sight.t_s - first.t_s
        end
    end
    if is_unicast(body) then
        self:_pass_on(body, sight, note, grace_s)
    end
end

function Conversations:_acknowledge(body, sight)
    for _, sequence in ipairs(body.sequences) do
        local key = joined(sight.interface, sight.to, sight.source, sequence)
        local sent = self.waiting[key]
        if sent then
            self.waiting[key] = nil
            sent.acked_in, sent.acked_after_s = sight.frame, sight.t_s - sent.t_s
        end
    end
end

-- A relay has what it is to pass on from its arrival until it leaves. What is less urgent and leaves for the same
-- neighbour meanwhile, goes before its turn.
function Conversations:_pass_on(body, sight, note, grace_s)
    local passing = joined(sight.node, body.key)
    if sight.is_inbound then
        self.arrivals[passing] = self.arrivals[passing] or sight.t_s
    elseif sight.is_outbound then
        local way = joined(sight.node, sight.source, sight.to)
        local departures = self.departures[way] or {}
        self.departures[way] = departures
        local since_s = self.arrivals[passing]
        self.arrivals[passing] = nil
        if since_s then
            self:_inversions(departures, body, sight, since_s, grace_s)
        end
        departures[#departures + 1] = { t_s = sight.t_s, urgency = body.urgency, note = note }
    end
end

function Conversations:_inversions(departures, body, sight, since_s, grace_s)
    for position = #departures, 1, -1 do
        local entry = departures[position]
        if entry.t_s <= since_s + grace_s then
            break
        end
        if entry.urgency > body.urgency and entry.t_s < sight.t_s and not entry.note.inversion then
            entry.note.inversion = { urgency = body.urgency, waited_s = entry.t_s - since_s, done_in = sight.frame }
        end
    end
end

return { new = new }
