"""The wire format: every byte, every chunking, every loss."""

from __future__ import annotations

import re
import struct
from itertools import pairwise
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.apparatus.tracker import frames as tracker_frames
from palpate.experiment.apparatus.tracker.frames import (
    FRAME_BYTES,
    LONGEST_PAUSE_US,
    Decoder,
    Frames,
    LinkCounts,
    encode,
)

WRAP_US = 2**32


def naive_crc(data: bytes) -> int:
    """CRC-16/IBM-3740 bit by bit, as the catalogue of parametrised CRC algorithms defines it."""
    crc = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            top = crc >> 15 ^ byte >> bit & 1
            crc = (crc << 1 & 0xFFFF) ^ (0x1021 if top else 0)
    return crc


def naive_cobs(data: bytes) -> bytes:
    """Cheshire and Baker 1999, section III, for less than 254 bytes: each zero becomes the distance to the next one."""
    stuffed = b""
    for block in data.split(b"\0"):
        stuffed += bytes([len(block) + 1]) + block
    return stuffed


def naive_frame(sequence: int, device_us: int, *readings: int) -> bytes:
    sample = struct.pack("<HI" + "H" * len(readings), sequence, device_us, *readings)
    return naive_cobs(sample + struct.pack("<H", naive_crc(sample))) + b"\0"


def stream(count: int, *, sequence: int = 0, start_us: int = 0, period_us: int = 1000) -> list[bytes]:
    return [encode(sequence + i, start_us + i * period_us, i % 65536) for i in range(count)]


def read(decoder: Decoder, pieces: list[bytes]) -> tuple[Decoder, list[int], list[int], LinkCounts]:
    times: list[int] = []
    counts: list[int] = []
    link = LinkCounts()
    for piece in pieces:
        decoder, frames = decoder.feed(piece)
        times += frames.device_us.tolist()
        counts += frames.counts.tolist()
        link = link.plus(frames.link)
    return decoder, times, counts, link


def cut(data: bytes, places: list[int]) -> list[bytes]:
    edges = [0, *sorted(place % (len(data) + 1) for place in places), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


def test_the_crc_is_the_named_one() -> None:
    # The catalogue's check value of CRC-16/IBM-3740.
    assert naive_crc(b"123456789") == 0x29B1


@given(st.integers(0, 65535), st.integers(0, WRAP_US - 1), st.lists(st.integers(0, 65535), min_size=1, max_size=2))
def test_a_frame_is_what_the_format_says(sequence: int, device_us: int, readings: list[int]) -> None:
    frame = encode(sequence, device_us, *readings)
    assert frame == naive_frame(sequence, device_us, *readings)
    assert len(frame) == {1: 12, 2: 14}[len(readings)] == FRAME_BYTES[len(readings)]
    assert frame.count(0) == 1


def test_sequence_and_time_wrap() -> None:
    assert encode(65536 + 7, WRAP_US + 9, 3) == encode(7, 9, 3)


@given(
    st.lists(st.integers(0, 65535), min_size=1, max_size=80),
    st.integers(0, 65535),
    st.integers(0, WRAP_US - 1),
    st.lists(st.integers(0, 10**4), max_size=12),
)
def test_any_chunking_gives_back_what_was_sent(
    readings: list[int], sequence: int, start_us: int, places: list[int]
) -> None:
    data = b"".join(encode(sequence + i, start_us + 200 * i, reading) for i, reading in enumerate(readings))
    _, times, counts, link = read(Decoder(near_us=start_us), cut(data, places))
    assert times == [start_us + 200 * i for i in range(len(readings))]
    assert counts == readings
    assert link == LinkCounts(received=len(readings))


@given(
    st.lists(st.tuples(st.integers(0, 65535), st.integers(0, 65535)), min_size=1, max_size=80),
    st.lists(st.integers(0, 10**4), max_size=12),
    st.sets(st.integers(0, 79), max_size=3),
    st.integers(0, 111),
)
def test_a_planar_stream_gives_back_both_readings_of_every_frame_that_is_whole(
    readings: list[tuple[int, int]], places: list[int], spoilt: set[int], bit: int
) -> None:
    sent = [naive_frame(i, 200 * i, *pair) for i, pair in enumerate(readings)]
    good = [i for i in range(len(sent)) if i not in spoilt]
    for i in set(range(len(sent))) - set(good):
        changed = bytearray(sent[i])
        changed[bit // 8] ^= 1 << bit % 8
        sent[i] = bytes(changed)
    decoder, found = Decoder(near_us=0, readings=2), list[tuple[int, int, int]]()
    for piece in cut(b"".join(sent), places):
        decoder, frames = decoder.feed(piece)
        found += zip(frames.device_us.tolist(), frames.counts.tolist(), frames.along.tolist(), strict=True)
    # A wrong bit may make an end of frames vanish, and the frame after it with it; no frame is ever another one.
    assert set(found) <= {(200 * i, *readings[i]) for i in good}
    assert len(found) >= len(good) - len(spoilt)
    if good == list(range(len(sent))):
        assert len(found) == len(sent)


@pytest.mark.parametrize("readings", [1, 2])
@given(places=st.lists(st.integers(0, 10**4), max_size=12))
def test_frames_of_the_other_kind_are_damaged_and_among_them_ours_are_read(readings: int, places: list[int]) -> None:
    other = [encode(i, 1000 * i, *[7] * (3 - readings)) for i in range(1, 50)]
    ours = [encode(i, 1000 * i, *[9] * readings) for i in (0, 50)]
    data = ours[0] + b"".join(other) + ours[1]
    _, times, counts, link = read(Decoder(readings=readings), cut(data, places))
    assert (times, counts) == ([0, 50_000], [9, 9])
    assert link == LinkCounts(received=2, damaged=49)


@pytest.mark.parametrize(
    ("readings", "told"), [(1, "12 bytes per frame: .* has no "), (2, "14 bytes per frame: .* has a ")]
)
def test_which_frames_are_read_is_told(readings: int, told: str) -> None:
    assert re.match(told, Decoder(readings=readings).kind)


def test_ends_are_where_the_frames_end() -> None:
    data = b"".join(stream(5))
    decoder, first = Decoder().feed(data[:17])
    _, rest = decoder.feed(data[17:])
    assert first.ends.tolist() == [12]
    assert (rest.ends + 17).tolist() == [24, 36, 48, 60]


def test_time_is_unwrapped_and_stays_so() -> None:
    start_us = WRAP_US - 1500
    _, times, _, link = read(Decoder(), stream(4, sequence=65534, start_us=start_us))
    assert times == [start_us, start_us + 1000, start_us + 2000, start_us + 3000]
    assert link.lost == 0


@pytest.mark.parametrize("near_us", [0, 5 * WRAP_US + 17, 5 * WRAP_US - 10**9, 10**12])
def test_the_first_time_is_the_one_nearest_to_what_is_known(near_us: int) -> None:
    _, frames = Decoder(near_us=near_us).feed(encode(0, 12_345, 0))
    (time_us,) = frames.device_us.tolist()
    assert time_us % WRAP_US == 12_345
    assert abs(time_us - near_us) <= WRAP_US // 2


@given(st.sets(st.integers(1, 298), max_size=280), st.lists(st.integers(0, 10**4), max_size=5))
def test_every_dropped_frame_is_counted_once(dropped: set[int], places: list[int]) -> None:
    data = b"".join(frame for i, frame in enumerate(stream(300, sequence=65400)) if i not in dropped)
    _, times, _, link = read(Decoder(), cut(data, places))
    assert link == LinkCounts(received=300 - len(dropped), lost=len(dropped))
    assert times == [1000 * i for i in range(300) if i not in dropped]


def test_a_long_loss_is_counted_exactly() -> None:
    frames = stream(65537)
    _, _, _, link = read(Decoder(), [frames[0], frames[65535], frames[65536]])
    assert link == LinkCounts(received=3, lost=65534)


@given(st.sets(st.integers(0, 99)), st.lists(st.integers(0, 10**4), max_size=5))
def test_a_repeated_frame_is_dropped_and_counted(repeated: set[int], places: list[int]) -> None:
    data = b"".join(frame * (2 if i in repeated else 1) for i, frame in enumerate(stream(100)))
    _, times, _, link = read(Decoder(), cut(data, places))
    assert times == [1000 * i for i in range(100)]
    assert link == LinkCounts(received=100, repeated=len(repeated))


@given(st.dictionaries(st.integers(1, 198), st.tuples(st.integers(0, 10), st.integers(1, 255)), max_size=60))
def test_a_damaged_frame_is_counted_once_and_never_also_as_lost(spoilt: dict[int, tuple[int, int]]) -> None:
    frames = stream(200)
    for i, (place, mask) in spoilt.items():
        changed = frames[i][place] ^ mask
        frames[i] = frames[i][:place] + bytes([changed or 0xFF]) + frames[i][place + 1 :]
    untouched = {i for i, frame in enumerate(stream(200)) if frames[i] == frame}
    _, times, _, link = read(Decoder(), [b"".join(frames)])
    assert times == [1000 * i for i in sorted(untouched)]
    assert link == LinkCounts(received=len(untouched), damaged=200 - len(untouched))


@pytest.mark.parametrize("seed", range(20))
def test_random_corruption_never_gives_a_wrong_frame(seed: int) -> None:
    # One in 2^16 damaged frames passes a 16-bit CRC by chance; with these seeds none does.
    rng = np.random.default_rng(seed)
    sent = {(1000 * i, i % 65536) for i in range(2000)}
    data = bytearray(b"".join(stream(2000)))
    for place in rng.integers(FRAME_BYTES[1], len(data) - FRAME_BYTES[1], 400):
        data[place] = rng.integers(0, 256)
    _, times, counts, link = read(Decoder(), cut(bytes(data), rng.integers(0, len(data), 50).tolist()))
    assert set(zip(times, counts, strict=True)) <= sent
    assert all(a < b for a, b in pairwise(times))
    assert link.received == len(times)
    missing = 2000 - link.received
    # A byte that becomes 0x00 tears one frame in two; a 0x00 that changes joins two.
    assert link.lost <= missing <= link.lost + link.damaged


@given(st.lists(st.binary(max_size=60), max_size=10))
def test_no_bytes_whatever_upset_the_decoder(pieces: list[bytes]) -> None:
    decoder, times, _, link = read(Decoder(), pieces)
    assert link.received == len(times)
    assert len(decoder.tail) <= FRAME_BYTES[1]


def test_a_flood_without_an_end_takes_no_memory_and_is_one_damaged_stretch() -> None:
    decoder, *_ = read(Decoder(), stream(2))
    decoder, _, _, link = read(decoder, [b"\x55" * 4000] * 50)
    assert len(decoder.tail) <= FRAME_BYTES[1]
    _, times, _, more = read(decoder, [b"\0", encode(3, 3000, 0)])
    assert link.plus(more) == LinkCounts(received=1, damaged=1)
    assert times == [3000]


@pytest.mark.parametrize("begin", range(1, FRAME_BYTES[1]))
def test_where_reading_begins_the_rest_of_a_frame_is_not_damage(begin: int) -> None:
    _, times, _, link = read(Decoder(), [b"".join(stream(3))[begin:]])
    assert times == [1000, 2000]
    assert link == LinkCounts(received=2)


def test_empty_stretches_are_nothing() -> None:
    _, times, _, link = read(Decoder(), [b"\0\0" + encode(0, 0, 0) + b"\0\0\0" + encode(1, 1000, 0)])
    assert times == [0, 1000]
    assert link == LinkCounts(received=2)


def test_what_was_thrown_away_is_not_lost_but_what_is_lost_after_it_is() -> None:
    frames = stream(100)
    decoder, *_ = read(Decoder(), [*frames[:10], frames[10][:5]])
    _, times, _, link = read(decoder.skipped(), [frames[49][6:], *frames[50:60], *frames[63:70]])
    assert link == LinkCounts(received=17, lost=3)
    assert times[0] == 50_000


def test_after_a_gap_all_frames_but_the_first_are_read_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = stream(700)
    decoder, *_ = read(Decoder(), frames[:10])
    alone = Mock(wraps=tracker_frames._sample)
    monkeypatch.setattr(tracker_frames, "_sample", alone)
    _, times, *_ = read(decoder.skipped(), [b"".join(frames[50:])])
    assert (len(times), alone.call_count) == (650, 1)


def test_throwing_away_before_the_first_frame_changes_nothing() -> None:
    frames = stream(5)
    _, _, _, link = read(Decoder().skipped(), [frames[0], frames[4]])
    assert link == LinkCounts(received=2, lost=3)


def test_a_pause_in_device_time_is_no_loss() -> None:
    _, times, _, link = read(Decoder(), [encode(7, 1000, 0), encode(8, 1000 + 1_800_000_000, 0)])
    assert times == [1000, 1_800_001_000]
    assert link == LinkCounts(received=2)


def restarting() -> list[tuple[str, list[bytes]]]:
    running = stream(50, sequence=5000, start_us=90_000_000)
    return [
        ("from the beginning", [*running, *stream(50)]),
        ("without a gap in sequence", [*running, *stream(50, sequence=5050)]),
        ("the clock stands still", [*running, encode(5050, 90_049_000, 1), encode(5051, 90_050_000, 1)]),
        ("after more than half a wrap", [*stream(5, start_us=WRAP_US - LONGEST_PAUSE_US - 10_000), *stream(5)]),
    ]


@pytest.mark.parametrize("sent", [sent for _, sent in restarting()], ids=[name for name, _ in restarting()])
@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("drained", [True, False])
def test_a_restart_gives_no_time_of_another_clock(sent: list[bytes], whole: bool, drained: bool) -> None:
    before = (
        [1000 * i + 90_000_000 for i in range(50)]
        if len(sent) > 10
        else [WRAP_US - 60_010_000 + 1000 * i for i in range(5)]
    )
    decoder = Decoder()
    times: list[int] = []
    last: Frames | None = None
    pieces = [b"".join(sent)] if whole else sent
    for i, piece in enumerate(pieces):
        if drained and not whole and i == len(before):
            decoder = decoder.skipped()
        decoder, last = decoder.feed(piece)
        times += last.device_us.tolist()
    assert times == before
    assert last is not None
    assert last.restarted
    assert decoder.skipped().feed(encode(0, 0, 0))[1].restarted


@pytest.mark.parametrize("jump_us", [1000, LONGEST_PAUSE_US])
def test_a_wrap_is_no_restart(jump_us: int) -> None:
    first_us = WRAP_US - 500
    decoder, _ = Decoder().feed(encode(0, first_us, 0))
    _, frames = decoder.feed(encode(1, first_us + jump_us, 0))
    assert frames.device_us.tolist() == [first_us + jump_us]
    assert not frames.restarted


def test_a_decoder_is_not_changed_by_feeding_it() -> None:
    decoder, _ = Decoder().feed(b"".join(stream(3)) + b"\x03")
    same = Decoder(**decoder._asdict())
    for _ in range(2):
        _, frames = decoder.feed(b"".join(stream(3, sequence=3, start_us=3000)))
        assert frames.link == LinkCounts(received=2, damaged=1)
    assert decoder == same


@given(st.integers(0, 2**32), st.lists(st.integers(0, 2000)), st.data())
def test_a_stream_with_faults_reads_the_same_however_it_is_cut(
    seed: int, places: list[int], data: st.DataObject
) -> None:
    rng = np.random.default_rng(seed)
    start_us = int(rng.choice([0, WRAP_US - 30_000, 5_000_000]))
    sent = stream(100, sequence=int(rng.choice([0, 65_500])), start_us=start_us)
    for kind in data.draw(
        st.lists(st.sampled_from(["drop", "repeat", "flip", "zero", "garbage", "restart"]), max_size=3)
    ):
        at = int(rng.integers(0, len(sent)))
        frame = bytearray(sent[at])
        frame[int(rng.integers(0, len(frame)))] ^= 1 << int(rng.integers(0, 8))
        frames = {
            "drop": [],
            "repeat": [sent[at], sent[at]],
            "flip": [bytes(frame)],
            "zero": [sent[at], b"\0"],
            "garbage": [rng.bytes(12), sent[at]],
            "restart": [*stream(3), sent[at]],
        }[kind]
        sent[at : at + 1] = frames
    whole = b"".join(sent)
    at_once, decoded = Decoder().feed(whole)
    in_pieces, times, counts, link = read(Decoder(), cut(whole, places))
    assert in_pieces == at_once
    assert (times, counts, link) == (decoded.device_us.tolist(), decoded.counts.tolist(), decoded.link)


KNOWN = Decoder(period_us=1000.0)


@given(st.integers(1, 48), st.integers(0, 65535), st.integers(0, WRAP_US - 1), st.lists(st.integers(0, 10**4)))
def test_a_frame_that_nobody_sent_is_not_believed_though_its_crc_is_right(
    at: int, sequence: int, clock_us: int, places: list[int]
) -> None:
    sent = stream(50)
    steps = sequence - (at - 1)
    fits = steps > 0 and abs(clock_us - 1000 * sequence) <= 250 + 20 * steps
    follows = sequence == at - 1 and clock_us == 1000 * (at - 1)
    if fits or follows:
        return
    forged = [*sent[:at], encode(sequence, clock_us, 7), *sent[at + 1 :]]
    _, times, counts, link = read(KNOWN, cut(b"".join(forged), places))
    assert times == [1000 * i for i in range(50) if i != at]
    assert counts == [i for i in range(50) if i != at]
    assert link == LinkCounts(received=49, damaged=1)


def test_two_frames_that_agree_are_believed_whatever_their_time() -> None:
    later = stream(3, sequence=10, start_us=5_000_000)
    decoder, times, _, link = read(KNOWN, [*stream(10), *later])
    assert times == [*range(0, 10_000, 1000), 5_000_000, 5_001_000, 5_002_000]
    assert link == LinkCounts(received=13)
    assert decoder.held is None


def test_a_clock_twice_as_fast_is_read_on_for_others_to_judge() -> None:
    _, times, _, link = read(KNOWN, stream(11, period_us=2000))
    assert times == list(range(0, 22_000, 2000))
    assert link == LinkCounts(received=11)


def test_two_frames_that_changed_places_are_one_lost_and_no_restart() -> None:
    sent = stream(10)
    sent[4], sent[5] = sent[5], sent[4]
    decoder, times, _, _ = read(KNOWN, sent)
    assert times == [1000 * i for i in range(10) if i != 4]
    assert not decoder.restarted


@pytest.mark.parametrize("sent", [sent for _, sent in restarting()], ids=[name for name, _ in restarting()])
def test_a_restart_is_known_by_its_second_frame(sent: list[bytes]) -> None:
    number = int(len(sent) > 60) * 50 + int(len(sent) == 52) * 50 or 5
    decoder, *_ = read(KNOWN, sent[: number + 1])
    assert not decoder.restarted
    assert KNOWN.feed(b"".join(sent))[0].restarted


@given(st.integers(0, 2**32), st.lists(st.integers(0, 2000)))
def test_what_waits_is_the_same_however_the_stream_is_cut(seed: int, places: list[int]) -> None:
    rng = np.random.default_rng(seed)
    sent = stream(60, start_us=5_000_000)
    for at in rng.integers(0, 60, 6).tolist():
        sent[at] = encode(int(rng.integers(65536)), int(rng.integers(WRAP_US)), 9) * int(rng.integers(3))
    whole = b"".join(sent)
    _, at_once = KNOWN.feed(whole)
    _, times, counts, link = read(KNOWN, cut(whole, places))
    assert (times, counts, link) == (at_once.device_us.tolist(), at_once.counts.tolist(), at_once.link)
