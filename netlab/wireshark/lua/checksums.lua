-- The checksums of these protocols: CRC-16/CCITT (polynomial 0x1021, from 0) and CRC-32 (IEEE 802.3), of strings.

local checksums = {}

-- Lua 5.2, which Wireshark had up to 4.2, has no operator for bits, Lua 5.4 not these libraries.
local bxor = bit and bit.bxor or bit32 and bit32.bxor or load("return function(a, b) return a ~ b end")()

local crc16_of_byte, crc32_of_byte = {}, {}
for byte = 0, 255 do
    local high, low = byte * 256, byte
    for _ = 1, 8 do
        high = high >= 0x8000 and bxor(high * 2 % 0x10000, 0x1021) or high * 2
        low = low % 2 == 1 and bxor(math.floor(low / 2), 0xEDB88320) % 2 ^ 32 or math.floor(low / 2)
    end
    crc16_of_byte[byte], crc32_of_byte[byte] = high, low
end

function checksums.crc16(bytes)
    local crc = 0
    for position = 1, #bytes do
        crc = bxor(crc % 256 * 256, crc16_of_byte[bxor(math.floor(crc / 256), bytes:byte(position))])
    end
    return crc
end

function checksums.crc32(bytes)
    local crc = 0xFFFFFFFF
    for position = 1, #bytes do
        crc = bxor(math.floor(crc / 256), crc32_of_byte[bxor(crc % 256, bytes:byte(position)) % 256]) % 2 ^ 32
    end
    return 0xFFFFFFFF - crc
end

return checksums
