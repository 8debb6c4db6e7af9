"""Which datagrams of one sender were seen already: a sliding window over their numbers, as in RFC 6479."""

from __future__ import annotations

WINDOW = 8192
"""How far behind the newest number a datagram may arrive: 0.1 s of a gigabit of full datagrams."""
_WORD_BITS = 64
_WORDS = WINDOW // _WORD_BITS + 1  # the word of the newest number is used in part


class ReplayWindow:
    """Numbers from 0 on, each taken once. Bounded: 129 words, whatever arrives."""

    __slots__ = ("_newest_word", "_words")

    def __init__(self) -> None:
        self._newest_word = 0
        self._words = [0] * _WORDS

    def is_new(self, number: int) -> bool:
        """Whether this number was not taken yet and is not too far behind to know."""
        word = number // _WORD_BITS
        if word > self._newest_word:
            return True
        if word + _WORDS <= self._newest_word:
            return False
        return not self._words[word % _WORDS] >> number % _WORD_BITS & 1

    def take(self, number: int) -> None:
        """Remember a number that :meth:`is_new`. Call it for authenticated datagrams only."""
        word = number // _WORD_BITS
        if word > self._newest_word:
            for passed in range(max(self._newest_word + 1, word - _WORDS + 1), word + 1):
                self._words[passed % _WORDS] = 0
            self._newest_word = word
        self._words[word % _WORDS] |= 1 << number % _WORD_BITS
