-- udp_mesh datagrams as Lua tables: a pure reader of bytes, without anything of Wireshark (docs/wire.md).
--
-- It refuses what udp_mesh/core/wire.py refuses and calls the reasons by the same names, so that a dissection tells
-- what a daemon would have counted. Offsets are from 0 and from the beginning of the datagram. 48-bit numbers are Lua
-- numbers, which hold them exactly; 64-bit numbers are strings of 8 bytes.

local unsigned = require("big_endian").unsigned

local wire = {}

wire.VERSION = 1
wire.HEADER_BYTES = 22
wire.DATA_BYTES = 15
wire.CLEAR_BYTES = 30 -- of a sealed datagram, before the encrypted frames
wire.TAG_BYTES = 16
wire.LAST_NUMBER = 2 ^ 48 - 1 -- of every introduction

wire.DATA, wire.ACK, wire.HELLO, wire.PROBE, wire.PING, wire.FLOOR, wire.PURGED, wire.BACKLOG = 1, 2, 3, 4, 5, 6, 7, 8
wire.LINK = 16
wire.TYPES = {
    [1] = "DATA", [2] = "ACK", [3] = "HELLO", [4] = "PROBE", [5] = "PING", [6] = "FLOOR", [7] = "PURGED",
    [8] = "BACKLOG", [16] = "LINK",
}

local MAX_NAME_BYTES = 63
local OPENING = "uM" .. string.char(wire.VERSION)
local TRAFFIC_BYTES = 18

local function has_bit(value, bit)
    return math.floor(value / bit) % 2 == 1
end

-- Strict UTF-8 as RFC 3629 has it: no surrogates, nothing longer than needed, nothing above U+10FFFF.
local function is_utf8(text)
    local at = 1
    while at <= #text do
        local first, second = text:byte(at, at + 1)
        local size = first < 0x80 and 1 or first < 0xC2 and 0 or first < 0xE0 and 2 or first < 0xF0 and 3
            or first < 0xF5 and 4 or 0
        if size == 0 or at + size - 1 > #text then
            return false
        end
        for position = at + 1, at + size - 1 do
            local byte = text:byte(position)
            if byte < 0x80 or byte > 0xBF then
                return false
            end
        end
        if (first == 0xE0 and second < 0xA0) or (first == 0xED and second > 0x9F)
            or (first == 0xF0 and second < 0x90) or (first == 0xF4 and second > 0x8F) then
            return false
        end
        at = at + size
    end
    return true
end

-- Reads `count` tags of 4 bytes; nil if they are not all there.
local function read_tags(bytes, at, count)
    if at + 4 * count > #bytes then
        return nil
    end
    local tags = {}
    for position = 0, count - 1 do
        tags[position + 1] = unsigned(bytes, at + 4 * position, 4)
    end
    return tags
end

-- Each reader is told where a frame begins and returns it with its `size`, or nil and the reason. The bytes of its head
-- are there, as far as HEAD_BYTES says.
local HEAD_BYTES = { [1] = 15, [2] = 18, [3] = 11, [4] = 2, [5] = 1, [6] = 7, [7] = 7, [8] = 2, [16] = 10 }
local readers = {}

readers[wire.DATA] = function(bytes, at)
    local frame = {
        flags = bytes:byte(at + 2),
        priority = bytes:byte(at + 3),
        length = unsigned(bytes, at + 3, 2),
        message_id = unsigned(bytes, at + 5, 6),
        index = unsigned(bytes, at + 11, 2),
        count = unsigned(bytes, at + 13, 2),
        topic_bytes = 0,
    }
    frame.size = wire.DATA_BYTES + frame.length
    if at + frame.size > #bytes then
        return nil, "truncated"
    elseif frame.index >= frame.count or frame.flags > 1 then
        return nil, "impossible_value"
    end
    frame.has_envelope = frame.flags == 1
    if frame.index == 0 then
        local length = frame.length > 0 and bytes:byte(at + 16) or 0
        if length == 0 or 1 + length > frame.length then
            return nil, "impossible_value"
        end
        frame.topic, frame.topic_bytes = bytes:sub(at + 17, at + 16 + length), 1 + length
        if not is_utf8(frame.topic) then
            return nil, "impossible_value"
        end
    end
    frame.payload_at = at + wire.DATA_BYTES + frame.topic_bytes
    frame.payload = bytes:sub(frame.payload_at + 1, at + frame.size)
    return frame
end

readers[wire.ACK] = function(bytes, at)
    local largest, further = unsigned(bytes, at + 1, 6), bytes:byte(at + 18)
    local frame = { largest = largest, further = further, size = 18 + 4 * further }
    local last, first = largest, largest - unsigned(bytes, at + 15, 2)
    frame.ranges = { { first, last } }
    if at + frame.size > #bytes then
        return nil, "truncated"
    end
    for position = at + 18, at + frame.size - 4, 4 do
        last = first - unsigned(bytes, position, 2) - 2
        first = last - unsigned(bytes, position + 2, 2)
        frame.ranges[#frame.ranges + 1] = { first, last }
    end
    if first < 0 then
        return nil, "impossible_value"
    end
    return frame
end

readers[wire.HELLO] = function(bytes, at)
    local tags, name_bytes = bytes:byte(at + 10, at + 11)
    local frame = { tags = read_tags(bytes, at + 11, tags), size = 11 + 4 * tags + name_bytes }
    if at + frame.size > #bytes then
        return nil, "truncated"
    end
    frame.name_at = at + 11 + 4 * tags
    frame.name = bytes:sub(frame.name_at + 1, at + frame.size)
    -- The daemon refuses all that Unicode does not call printable; this refuses control characters.
    if name_bytes == 0 or name_bytes > MAX_NAME_BYTES or not is_utf8(frame.name)
        or frame.name:find("[\0-\31\127]") or frame.name:find("\194[\128-\159]") then
        return nil, "impossible_value"
    end
    return frame
end

local function read_tagged(head_bytes)
    return function(bytes, at)
        local count = bytes:byte(at + head_bytes)
        local frame = { tags = read_tags(bytes, at + head_bytes, count), size = head_bytes + 4 * count }
        if not frame.tags then
            return nil, "truncated"
        end
        return frame
    end
end

local function read_message_id(bytes, at)
    return { message_id = unsigned(bytes, at + 1, 6), size = 7 }
end

readers[wire.PROBE] = read_tagged(2)
readers[wire.LINK] = read_tagged(10)
readers[wire.FLOOR] = read_message_id
readers[wire.PURGED] = read_message_id
readers[wire.PING] = function()
    return { size = 1 }
end
readers[wire.BACKLOG] = function(bytes, at)
    return { priority = bytes:byte(at + 2), size = 2 }
end

local function read_frame(bytes, at)
    local kind = bytes:byte(at + 1)
    if not readers[kind] then
        return nil, "unknown_frame"
    elseif at + HEAD_BYTES[kind] > #bytes then
        return nil, "truncated"
    end
    local frame, reason = readers[kind](bytes, at)
    if frame then
        frame.kind, frame.at = kind, at
    end
    return frame, reason
end

local function read_header(bytes)
    local flags = bytes:byte(4)
    return {
        flags = flags,
        is_unnumbered = has_bit(flags, 1),
        is_sealed = has_bit(flags, 4),
        epoch = bytes:sub(5, 12),
        tag = unsigned(bytes, 8, 4), -- the sender's: the low half of its epoch
        destination_tag = unsigned(bytes, 12, 4),
        number = unsigned(bytes, 16, 6),
        frames = {},
        size = #bytes,
    }
end

-- Whether bytes begin as a datagram of this version does.
function wire.is_datagram(bytes)
    return #bytes >= wire.HEADER_BYTES and bytes:sub(1, 3) == OPENING
end

-- Returns a datagram with its `frames`; with `bad`, the reason for which a daemon drops it, those before the damage.
--
-- Where a sender's kernel cuts a burst into datagrams (UDP_SEGMENT), a capture on the sender may hold it uncut: the
-- first datagram then ends where the next begins, and its `size` is less than that of the bytes.
function wire.read(bytes)
    if #bytes < wire.HEADER_BYTES then
        return { bad = bytes:sub(1, 2) == "uM" and "truncated" or "foreign", frames = {}, size = #bytes }
    elseif bytes:sub(1, 2) ~= "uM" then
        return { bad = "foreign", frames = {}, size = #bytes }
    end
    local packet = read_header(bytes)
    if bytes:byte(3) ~= wire.VERSION then
        packet.bad = "unknown_version"
    elseif packet.is_sealed then
        packet.bad = #bytes < wire.CLEAR_BYTES + wire.TAG_BYTES and "truncated" or nil
    elseif packet.flags - packet.flags % 32 ~= 0 then
        packet.bad = "unknown_flags"
    else
        local at = wire.HEADER_BYTES
        while at < #bytes and not packet.bad do
            local frame, reason = read_frame(bytes, at)
            if frame then
                packet.frames[#packet.frames + 1] = frame
                at = at + frame.size
            elseif at > wire.HEADER_BYTES and wire.is_datagram(bytes:sub(at + 1)) then
                packet.size = at
                break
            else
                packet.bad, packet.bad_at = reason, at
            end
        end
    end
    return packet
end

-- Whether the receiver acknowledges a datagram: a unicast with data or a ping.
function wire.is_ack_eliciting(packet)
    for _, frame in ipairs(packet.frames) do
        if frame.kind == wire.DATA or frame.kind == wire.PING then
            return not packet.is_unnumbered
        end
    end
    return false
end

-- The parts of an envelope in their order: feature bit, name, and the parts' fields with their sizes.
wire.ENVELOPE = {
    { bit = 0x01, fields = { { "store", 8 }, { "sequence", 8 }, { "floor", 8 } } },
    { bit = 0x04, fields = { { "request", 8 } } },
    { bit = 0x08, fields = { { "response", 8 }, { "status", 1 } } },
    { bit = 0x10, fields = { { "original_bytes", 4 } } },
}

-- Returns an envelope: its `size`, and per field the place {offset, size} and the bytes; nil if it cannot be read.
function wire.read_envelope(payload)
    local features = payload:byte(1) or 0
    if features == 0 or features > 0x1F then
        return nil
    end
    local envelope, at = { features = features, places = {} }, 1
    for _, part in ipairs(wire.ENVELOPE) do
        for _, field in ipairs(has_bit(features, part.bit) and part.fields or {}) do
            local name, size = field[1], field[2]
            envelope.places[name] = { at, size }
            envelope[name] = payload:sub(at + 1, at + size)
            at = at + size
        end
    end
    envelope.confirms = has_bit(features, 0x02)
    envelope.size = at
    return at <= #payload and envelope or nil
end

-- Returns when a message of netlab's traffic was published: seconds and nanoseconds of CLOCK_REALTIME; nil of others.
function wire.published(payload)
    if payload:sub(1, 4) ~= "NLT1" or #payload < TRAFFIC_BYTES then
        return nil
    end
    local seconds, rest = 0, 0 -- long division by 10^9, byte by byte: the number of nanoseconds itself would be rounded
    for position = TRAFFIC_BYTES, TRAFFIC_BYTES - 7, -1 do
        rest = rest * 256 + payload:byte(position)
        seconds = seconds * 256 + math.floor(rest / 1e9)
        rest = rest % 1e9
    end
    return seconds, rest
end

return wire
