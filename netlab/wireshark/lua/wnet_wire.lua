-- wnet's frames as Lua tables: a pure reader of bytes, without anything of Wireshark (wnet/core/wire.py and
-- wire_control.py beside it).
--
-- It refuses what these refuse, by the same names. Offsets are from 0 and from the beginning of a body, which is a
-- frame without its outer Ethernet header.

local checksums = require "checksums"
local unsigned = require("big_endian").unsigned

local wire = {}

wire.HELLO, wire.ACK, wire.PROBE, wire.UNICAST, wire.MULTICAST = 0x11, 0x12, 0x13, 0x14, 0x15
wire.ROUTED, wire.FLOOD, wire.TC, wire.AGGREGATE, wire.SEALED = 0x16, 0x17, 0x18, 0x19, 0x1A
wire.KINDS = {
    [0x11] = "HELLO", [0x12] = "ACK", [0x13] = "PROBE", [0x14] = "UNICAST", [0x15] = "MULTICAST", [0x16] = "ROUTED",
    [0x17] = "FLOOD", [0x18] = "TC", [0x19] = "AGGREGATE", [0x1A] = "SEALED",
}
wire.HEAD_BYTES = 10
wire.ORIGIN_BYTES = 8
wire.SEAL_BYTES = 14 -- before the encrypted body
wire.TAG_BYTES = 16
wire.AGE_UNIT_S = 0.1 -- in which a TC tells its age, in the place of the link sequence

local ETHERNET_BYTES, KEY_BYTES, MAX_LISTED = 14, 20, 16
local HELLO_BYTES, TC_BYTES, ACK_BYTES, MAC_BYTES = 25, 16, 10, 6
wire.HEARD_BYTES, wire.TC_LINK_BYTES = 18, 10

-- The checksum of bytes in which it stands itself, at `at`, as if it were 0.
local function check_of(bytes, at)
    return checksums.crc16(bytes:sub(1, at) .. "\0\0" .. bytes:sub(at + 3))
end

-- Reads the addresses and groups of a node; nil if they are not all there.
local function read_info(bytes, at)
    if at + 2 > #bytes then
        return nil
    end
    local addresses, groups = bytes:byte(at + 1, at + 2)
    local info = { addresses_at = at + 2, addresses = addresses, groups_at = at + 2 + 4 * addresses, groups = groups }
    info.stop = info.groups_at + 6 * groups
    if math.max(addresses, groups) > MAX_LISTED or info.stop + 2 > #bytes then
        return nil
    end
    info.links, info.links_at = unsigned(bytes, info.stop, 2), info.stop + 2
    return info
end

local function read_hello(bytes)
    if #bytes < HELLO_BYTES then
        return nil, "too_short"
    end
    local info = read_info(bytes, HELLO_BYTES)
    local size = info and info.links_at + wire.HEARD_BYTES * info.links
    if not info or bytes:byte(5) > 15 or size > #bytes then
        return nil, "malformed"
    elseif check_of(bytes:sub(1, size), 2) ~= unsigned(bytes, 2, 2) then
        return nil, "check"
    end
    return { info = info, size = size, is_partial = bytes:byte(2) % 2 == 1 }
end

local function read_ack(bytes)
    if #bytes < ACK_BYTES then
        return nil, "too_short"
    elseif check_of(bytes:sub(1, ACK_BYTES), 2) ~= unsigned(bytes, 2, 2) then
        return nil, "check"
    end
    local newest, bits = unsigned(bytes, 4, 2), unsigned(bytes, 6, 4)
    local ack = { size = ACK_BYTES, attempt = bytes:byte(2), sequences = { newest } }
    for back = 1, 32 do
        if bits % 2 == 1 then
            ack.sequences[#ack.sequences + 1] = (newest - back) % 0x10000
        end
        bits = math.floor(bits / 2)
    end
    return ack
end

local function read_tc(bytes)
    if #bytes < TC_BYTES then
        return nil, "too_short"
    end
    local info = read_info(bytes, TC_BYTES)
    local size = info and info.links_at + wire.TC_LINK_BYTES * info.links
    if not info or size > #bytes then
        return nil, "malformed"
    elseif check_of(bytes:sub(1, size), 12) ~= unsigned(bytes, 12, 2) then
        return nil, "check"
    end
    return { info = info, size = size }
end

-- What each next hop shall do: {at, size, peer (6 bytes), sequence, destinations}; and where the list ends.
local function read_hops(bytes, kind)
    local hops, at = {}, wire.HEAD_BYTES + 1
    local fixed = kind == wire.MULTICAST and 9 or 8
    for _ = 1, bytes:byte(wire.HEAD_BYTES + 1) do
        if at + fixed > #bytes then
            return nil
        end
        local hop = { at = at, peer = bytes:sub(at + 1, at + 6), sequence = unsigned(bytes, at + 6, 2) }
        hop.destinations = kind == wire.MULTICAST and bytes:byte(at + 9) or 0
        hop.size = fixed + MAC_BYTES * hop.destinations
        if at + hop.size > #bytes then
            return nil
        end
        hops[#hops + 1], at = hop, at + hop.size
    end
    return hops, at
end

local function read_list(bytes, kind)
    if kind == wire.UNICAST or kind == wire.PROBE then
        return {}, wire.HEAD_BYTES
    elseif #bytes <= wire.HEAD_BYTES then
        return nil
    elseif kind == wire.ROUTED then
        local stop = wire.HEAD_BYTES + 1 + MAC_BYTES * bytes:byte(wire.HEAD_BYTES + 1)
        return stop <= #bytes and {} or nil, stop
    end
    return read_hops(bytes, kind)
end

local function read_data(bytes, kind)
    if #bytes < wire.HEAD_BYTES then
        return nil, "too_short"
    end
    local hops, tail_at = read_list(bytes, kind)
    if not hops then
        return nil, "malformed"
    end
    local flags, length = bytes:byte(2), unsigned(bytes, 6, 2)
    local stop = kind == wire.PROBE and tail_at or tail_at + wire.ORIGIN_BYTES + length
    if stop > #bytes or (kind ~= wire.PROBE and length < ETHERNET_BYTES) then
        return nil, "malformed"
    elseif check_of(bytes:sub(1, math.min(tail_at + KEY_BYTES, stop)), 4) ~= unsigned(bytes, 4, 2) then
        return nil, "check"
    end
    local data = {
        size = stop, hops = hops, tail_at = tail_at, length = length, attempt = math.floor(flags / 2) % 8,
        hop_limit = bytes:byte(3), urgency = bytes:byte(4), sequence = unsigned(bytes, 8, 2),
        key = bytes:sub(tail_at + 1, tail_at + KEY_BYTES), -- tells the frame inside from all others, at every hop
    }
    if kind == wire.TC then
        data.tc, data.bad = read_tc(bytes:sub(tail_at + wire.ORIGIN_BYTES + 1, stop))
    end
    return data
end

-- Returns the places {at, size} of an aggregate's bodies, and where they end; nil if they are not what they say.
local function read_aggregate(bytes)
    local parts, at = {}, 1
    while at + 2 <= #bytes do
        local size = unsigned(bytes, at, 2)
        at = at + 2
        if size == 0 then
            break
        end
        local kind = bytes:byte(at + 1)
        if at + size > #bytes or kind == wire.AGGREGATE or kind == wire.SEALED then
            return nil, "malformed"
        end
        parts[#parts + 1], at = { at = at, size = size }, at + size
    end
    return { parts = parts, size = at }
end

local function read_seal(bytes)
    if #bytes < wire.SEAL_BYTES + wire.TAG_BYTES then
        return nil, "too_short"
    end
    return { size = math.min(#bytes, wire.SEAL_BYTES + unsigned(bytes, 12, 2)) }
end

local readers = {
    [wire.HELLO] = read_hello, [wire.ACK] = read_ack, [wire.AGGREGATE] = read_aggregate, [wire.SEALED] = read_seal,
}

-- Returns a body with its `kind` and `size`; with `bad`, the reason for which it is dropped.
function wire.read(bytes)
    local kind = bytes:byte(1)
    if not wire.KINDS[kind] then
        return { bad = "version", size = #bytes }
    end
    local body, reason = (readers[kind] or read_data)(bytes, kind)
    body = body or { bad = reason, size = #bytes }
    body.kind = kind
    return body
end

return wire
