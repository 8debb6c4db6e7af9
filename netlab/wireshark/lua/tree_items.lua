-- Items of the tree that no byte of the frame stands for.

local items = {}

-- A time in seconds, also a negative one, as Wireshark has it.
function items.duration(seconds)
    local sign = seconds < 0 and -1 or 1
    local nanoseconds = math.floor(sign * seconds * 1e9 + 0.5)
    return NSTime.new(sign * math.floor(nanoseconds / 1e9), sign * (nanoseconds % 1e9))
end

-- Adds a value that was worked out; nothing, and nil, if there is none.
function items.generated(tree, what, value)
    if value ~= nil then
        local item = tree:add(what, value)
        item:set_generated()
        return item
    end
end

return items
