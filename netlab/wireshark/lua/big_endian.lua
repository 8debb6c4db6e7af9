-- Numbers in network byte order, of strings.

local big_endian = {}

-- The number in `size` bytes behind the first `at`.
function big_endian.unsigned(bytes, at, size)
    local value = 0
    for position = at + 1, at + size do
        value = value * 256 + bytes:byte(position)
    end
    return value
end

return big_endian
