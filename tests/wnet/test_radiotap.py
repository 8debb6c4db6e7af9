"""Radiotap and 802.11 headers, judged by scapy."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.layers.dot11 import Dot11, RadioTap
from scapy.layers.l2 import LLC, SNAP

from netlab.medium.phy import PHYS
from wnet.io import dot11, radiotap

FRAME = bytes.fromhex("03574e657400 024e4c000001 88b6") + b"payload"
RATES = sorted({round(rate.bps) for phy in PHYS.values() for rate in phy.rates if phy.name != "subt"})


def test_a_receiver_s_header_is_what_others_read() -> None:
    told = RadioTap(
        radiotap.encode_received(signal_dbm=-61.4, noise_dbm=-91, rate_bps=24_000_000) + b"\x08" + bytes(30)
    )
    assert (told.dBm_AntSignal, told.dBm_AntNoise, told.Rate) == (-61, -91, 24.0)


def test_a_sender_s_header_asks_for_no_acknowledgement_no_retry_and_a_rate() -> None:
    told = RadioTap(radiotap.encode_transmit(6_000_000) + b"\x08" + bytes(30))
    assert str(told.TXFlags) == "NOACK"
    assert told.Rate == 6.0
    ht = RadioTap(radiotap.encode_received(signal_dbm=-50, noise_dbm=None, rate_bps=39_000_000) + b"\x08" + bytes(30))
    assert ht.MCS_index == 4
    assert "MCS_index" in str(ht.knownMCS)


@pytest.mark.parametrize("rate_bps", RATES)
def test_every_rate_of_the_lab_s_radios_survives(rate_bps: int) -> None:
    for data in (
        radiotap.encode_received(signal_dbm=-70, noise_dbm=None, rate_bps=rate_bps),
        radiotap.encode_transmit(rate_bps),
    ):
        header = radiotap.decode(data)
        assert header is not None
        assert header.rate_bps == rate_bps
        assert header.length_bytes == len(data)
        assert len(radiotap.encode_transmit(rate_bps)) <= radiotap.TRANSMIT_BYTES_MAX


def test_what_real_drivers_write_is_read() -> None:
    header = RadioTap(
        present="TSFT+Flags+Rate+Channel+dBm_AntSignal+Antenna+RXFlags",
        mac_timestamp=1 << 40,
        Flags="FCS",
        Rate=12.0,
        ChannelFrequency=2412,
        ChannelFlags="OFDM+2GHz",
        dBm_AntSignal=-77,
        Antenna=1,
    )
    found = radiotap.decode(bytes(header))
    assert found is not None
    assert (found.signal_dbm, found.noise_dbm, found.rate_bps) == (-77.0, None, 12_000_000)
    assert (found.has_fcs, found.is_bad, found.is_echo) == (True, False, False)


def test_several_words_of_present_bits_shift_the_fields() -> None:
    plain = radiotap.encode_received(signal_dbm=-40, noise_dbm=-90, rate_bps=None)
    more = bytearray(plain[:8] + (0).to_bytes(4, "little") + plain[8:])
    more[2:4] = len(more).to_bytes(2, "little")
    more[7] |= 0x80
    found = radiotap.decode(bytes(more))
    assert found is not None
    assert (found.signal_dbm, found.noise_dbm) == (-40.0, -90.0)


def test_an_echo_tells_that_it_is_one() -> None:
    header = radiotap.decode(radiotap.encode_transmit(None))
    assert header is not None
    assert header.is_echo
    assert header.rate_bps is None


@given(st.binary(max_size=80))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    header = radiotap.decode(data)
    assert header is None or 8 <= header.length_bytes <= len(data)
    dot11.decode(data)


def test_a_data_frame_is_what_others_read() -> None:
    on_air = dot11.encode(FRAME)
    told = Dot11(on_air)
    assert (told.type, told.subtype, told.addr1, told.addr2) == (2, 0, "03:57:4e:65:74:00", "02:4e:4c:00:00:01")
    assert told.haslayer(LLC)
    assert told[SNAP].code == 0x88B6
    assert len(on_air) == len(FRAME) + dot11.EXTRA_BYTES
    assert dot11.decode(on_air) == FRAME
    assert dot11.decode(b"xx" + on_air, 2) == FRAME


def test_frames_of_others_are_left_out() -> None:
    on_air = bytearray(dot11.encode(FRAME))
    on_air[1] |= 0x01  # to an access point
    assert dot11.decode(bytes(on_air)) is None
    assert dot11.decode(bytes(Dot11(type=0, subtype=8)) + bytes(60)) is None
    qos = dot11.encode(FRAME)
    assert dot11.decode(b"\x88" + qos[1:24] + b"\0\0" + qos[24:]) == FRAME
