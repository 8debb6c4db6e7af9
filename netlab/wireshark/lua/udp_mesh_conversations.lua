-- What datagrams have to do with each other: repeated, acknowledged, answered, overtaken. Nothing of Wireshark here.
--
-- Told each sound datagram once, in the order of the capture, it keeps what is to be shown with it. Much is known only
-- later (acknowledged in frame N), so it shows in a second pass.
--
-- A *place* is an interface. A *view* is a place with one direction and one link-layer sender (of frames that travel
-- inside others all senders count): there a sender's datagrams pass once, so the same one again is a duplicate, and the
-- same fragment in another one a retransmission. Answers are matched at one place, so that their times are those of
-- whoever captured there.

local wire = require "udp_mesh_wire"

local OUTSTANDING_S = 10 -- what was not acknowledged by then is no longer waited for

local Conversations = {}
Conversations.__index = Conversations

local function new()
    return setmetatable({
        notes = {}, -- by the key of a sight: what to show
        names = {}, -- by tag
        epochs = {}, -- by name: the epochs that it had
        first_sights = {}, -- by datagram, anywhere
        views = {}, -- datagrams and fragments by view
        messages = {}, -- by epoch and message id: topic, and the parts of the payload
        outstanding = {}, -- by place and direction: datagrams that wait for an acknowledgement
        probes = {}, -- by place, prober's and wanted tag
        requests = {}, -- by place, asker's tag and number
    }, Conversations)
end

local function joined(...)
    return table.concat({ ... }, "|")
end

-- The receiver of a datagram, by its name if a beacon told it: a restarted one has another tag.
function Conversations:_receiver(packet)
    return self.names[packet.destination_tag] or packet.destination_tag
end

-- Takes a datagram that was seen.
--
-- `sight`: key (of the notes), frame (number), t_s (seconds since any fixed time), place, sender (link layer), address
-- (network layer, of the receiver) and is_inbound (whether it is known to have come from elsewhere). `epoch_s`: what to
-- add to t_s for CLOCK_REALTIME.
function Conversations:see(packet, sight, grace_s, epoch_s)
    local note = { fragments = {}, frame = sight.frame, t_s = sight.t_s }
    self.notes[sight.key] = note
    self:_names(packet, note)
    if packet.number ~= wire.LAST_NUMBER or not packet.is_unnumbered then
        if self:_is_duplicate(packet, sight, note) then
            self:_topics(packet)
            return
        end
        if wire.is_ack_eliciting(packet) then
            local waiting = joined(sight.place, packet.tag, packet.destination_tag)
            self.outstanding[waiting] = self.outstanding[waiting] or {}
            table.insert(self.outstanding[waiting], { number = packet.number, note = note })
        end
    end
    for position, frame in ipairs(packet.frames) do
        if frame.kind == wire.DATA then
            note.fragments[position] = self:_fragment(packet, frame, sight, grace_s, epoch_s)
        elseif frame.kind == wire.ACK and not packet.is_unnumbered then
            self:_acknowledge(packet, frame, sight, note)
        elseif frame.kind == wire.PROBE then
            for _, tag in ipairs(frame.tags) do
                self.probes[joined(sight.place, packet.tag, tag)] = note
            end
        elseif frame.kind == wire.HELLO then
            self:_answer(packet, frame, sight, note)
        end
    end
end

function Conversations:_names(packet, note)
    for _, frame in ipairs(packet.frames) do
        if frame.kind == wire.HELLO then
            local epochs = self.epochs[frame.name] or { count = 0 }
            self.epochs[frame.name], self.names[packet.tag] = epochs, frame.name
            if not epochs[packet.epoch] then
                note.is_restart = epochs.count > 0
                epochs[packet.epoch], epochs.count = true, epochs.count + 1
            end
        end
    end
end

function Conversations:_is_duplicate(packet, sight, note)
    local datagram = joined(packet.epoch, packet.destination_tag, tostring(packet.is_unnumbered), packet.number)
    local first = self.first_sights[datagram]
    if not first then
        self.first_sights[datagram] = { note = note, place = sight.place }
    elseif first.place ~= sight.place then
        note.first_seen_in, note.transit_s = first.note.frame, sight.t_s - first.note.t_s
    end
    local view = joined(sight.place, sight.sender, sight.address, datagram)
    note.duplicate_of = self.views[view]
    self.views[view] = self.views[view] or sight.frame
    return note.duplicate_of ~= nil
end

function Conversations:_message(packet, frame)
    local key = joined(packet.epoch, frame.message_id)
    local message = self.messages[key]
    if not message then
        message = {
            count = frame.count, priority = frame.priority, flags = frame.flags, parts = {}, id = frame.message_id,
        }
        self.messages[key] = message
    end
    message.topic = message.topic or frame.topic
    return message
end

function Conversations:_topics(packet)
    for _, frame in ipairs(packet.frames) do
        if frame.kind == wire.DATA then
            self:_message(packet, frame)
        end
    end
end

-- Whether a fragment says otherwise than those before it; if not, its part of the message is kept.
local function contradicts(message, frame)
    if frame.count ~= message.count or frame.priority ~= message.priority or frame.flags ~= message.flags then
        return true
    end
    if frame.index < frame.count - 1 then
        message.length = message.length or frame.length
        if frame.length ~= message.length then
            return true
        end
    end
    message.parts[frame.index] = message.parts[frame.index] or frame.payload
    return false
end

function Conversations:_fragment(packet, frame, sight, grace_s, epoch_s)
    local message = self:_message(packet, frame)
    local note = { message = message }
    if contradicts(message, frame) then
        note.is_contradiction = true
        return note
    end
    local flow_key = joined(sight.place, sight.sender, packet.epoch, self:_receiver(packet))
    local flow = self.views[flow_key] or { sent = {}, passages = {} }
    self.views[flow_key] = flow
    local passage = flow.passages[frame.message_id]
    if not passage then
        passage = { message = message, seen = 0, frames = {}, since_s = sight.t_s }
        flow.passages[frame.message_id] = passage
    end
    note.passage = passage
    if frame.index == 0 then
        self:_published(passage, frame, sight, epoch_s)
    end
    table.insert(flow.sent, { t_s = sight.t_s, priority = frame.priority, note = note })
    local before = passage.frames[frame.index]
    if before then -- under one number it is a broadcast that goes to several addresses
        note.retransmission_of = before.number ~= packet.number and before.frame or nil
        return note
    end
    passage.frames[frame.index] = { frame = sight.frame, number = packet.number }
    passage.seen = passage.seen + 1
    if passage.seen == message.count then
        note.is_last = true
        passage.done_in, passage.took_s = sight.frame, sight.t_s - passage.since_s
        self:_request(packet, message, sight, note)
        if not packet.is_unnumbered and not sight.is_inbound then
            self:_inversions(flow, passage, sight, grace_s)
        end
    end
    return note
end

-- A message of netlab's traffic says when it was published: since then it has waited, not only since it began to leave.
function Conversations:_published(passage, frame, sight, epoch_s)
    local payload = frame.payload
    if frame.has_envelope then
        local envelope = wire.read_envelope(payload)
        payload = envelope and payload:sub(envelope.size + 1) or ""
    end
    local seconds, nanoseconds = wire.published(payload)
    if seconds then
        passage.published_s = math.min((seconds - epoch_s) + nanoseconds / 1e9, sight.t_s)
    end
end

-- A message has left as a whole: what was less urgent and left while some of it still waited, went before its turn.
function Conversations:_inversions(flow, passage, sight, grace_s)
    local since_s = math.min(passage.since_s, passage.published_s or passage.since_s)
    for position = #flow.sent, 1, -1 do
        local entry = flow.sent[position]
        if entry.t_s <= since_s + grace_s then
            break
        end
        if entry.priority > passage.message.priority and entry.t_s < sight.t_s and not entry.note.inversion then
            entry.note.inversion =
                { message = passage.message, waited_s = entry.t_s - since_s, done_in = sight.frame }
        end
    end
end

local function holds(ranges, number)
    local low, high = 1, #ranges -- newest first
    while low <= high do
        local middle = math.floor((low + high) / 2)
        if number > ranges[middle][2] then
            high = middle - 1
        elseif number < ranges[middle][1] then
            low = middle + 1
        else
            return true
        end
    end
    return false
end

function Conversations:_acknowledge(packet, frame, sight, note)
    local key = joined(sight.place, packet.destination_tag, packet.tag)
    local waiting = {}
    note.acks = note.acks or {}
    for _, entry in ipairs(self.outstanding[key] or {}) do
        if holds(frame.ranges, entry.number) then
            local after_s = sight.t_s - entry.note.t_s
            entry.note.acked_in, entry.note.acked_after_s = sight.frame, after_s
            table.insert(note.acks, entry.note.frame)
            if entry.number == frame.largest then
                note.largest_after_s = after_s
            end
        elseif sight.t_s - entry.note.t_s < OUTSTANDING_S then
            table.insert(waiting, entry)
        end
    end
    self.outstanding[key] = waiting
end

function Conversations:_answer(packet, frame, sight, note)
    for _, tag in ipairs(frame.tags) do
        local probe = self.probes[joined(sight.place, tag, packet.tag)] or self.probes[joined(sight.place, tag, 0)]
        if probe then
            note.answer_to, note.answer_after_s = probe.frame, sight.t_s - probe.t_s
            probe.answered_in = probe.answered_in or sight.frame
        end
    end
end

function Conversations:_request(packet, message, sight, note)
    local envelope = message.flags == 1 and wire.read_envelope(self.payload(message) or "")
    if not envelope then
        return
    end
    if envelope.request then
        self.requests[joined(sight.place, packet.tag, envelope.request)] = { note = note, sight = sight }
    end
    local asked = envelope.response and self.requests[joined(sight.place, packet.destination_tag, envelope.response)]
    if asked then
        note.request_in, note.request_after_s = asked.sight.frame, sight.t_s - asked.sight.t_s
        asked.note.response_in = sight.frame
    end
end

-- The payload of a message of which all parts are there, else nil.
function Conversations.payload(message)
    local parts = {}
    for index = 0, message.count - 1 do
        if not message.parts[index] then
            return nil
        end
        parts[index + 1] = message.parts[index]
    end
    return table.concat(parts)
end

return { new = new, payload = Conversations.payload }
