"""Characters, sums, replies: against the specification's examples, captures of real sensors, and bent bytes."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.scip import codec, status
from drivers.scip.replies import (
    DamagedReply,
    ReplyParser,
    info_of,
    is_scan,
    parameters_of,
    scan_of,
)
from drivers.scip.requests import Window

WIDTHS = st.sampled_from([2, 3, 4])
ECHO, WINDOW = b"MD0044072501000", Window(44, 725)


def streamed(values: np.ndarray, timer_ms: int = 4711, width: int = 3) -> bytes:
    head = [ECHO, codec.with_sum(b"99"), codec.with_sum(codec.encode(np.array([timer_ms]), 4))]
    return b"\n".join(head + codec.to_lines(codec.encode(values, width))) + b"\n\n"


def parse(data: bytes, pieces: list[int] | None = None) -> tuple[list, Counter[str]]:
    parser, out, at = ReplyParser(), [], 0
    for size in [*(pieces or []), len(data)]:
        out += list(parser.feed(data[at : at + size], 0.0))
        at += size
    return out, parser.faults


@pytest.mark.parametrize(("value", "text"), [(1234, b"CB"), (5432, b"1Dh"), (16_000_000, b"m2@0")])
def test_the_specification_s_examples(value: int, text: bytes) -> None:
    assert codec.decode(text, len(text)).tolist() == [value]
    assert codec.encode(np.array([value]), len(text)) == text


@given(width=WIDTHS, data=st.data())
def test_what_is_encoded_is_decoded(width: int, data: st.DataObject) -> None:
    values = data.draw(st.lists(st.integers(0, 64**width - 1), max_size=50))
    assert codec.decode(codec.encode(np.array(values, dtype=np.int64), width), width).tolist() == values


def test_too_large_a_value_is_refused() -> None:
    with pytest.raises(ValueError, match="4095"):
        codec.encode(np.array([4096]), 2)


@given(
    text=st.binary(max_size=70).map(lambda b: bytes(0x30 + c % 64 for c in b)),
    bit=st.integers(0, 7),
    data=st.data(),
)
def test_no_single_flipped_bit_passes_a_data_line(text: bytes, bit: int, data: st.DataObject) -> None:
    line = bytearray(codec.with_sum(text + b"0"))
    line[data.draw(st.integers(0, len(line) - 1))] ^= 1 << bit
    payload = codec.without_sum(bytes(line))
    assert payload is None or not codec.is_data(payload)


def test_info_lines_leave_the_semicolon_out_of_the_sum() -> None:
    assert codec.without_info_sum(b"PROT:SCIP 2.0;N") == (b"PROT:SCIP 2.0", True)
    assert codec.without_info_sum(b"PROT:SCIP 2.0;X") == (b"PROT:SCIP 2.0", False)
    assert codec.without_info_sum(b"TIME:j;o[;H") == (b"TIME:j;o[", True)  # the value has one itself


@given(
    width=st.sampled_from([2, 3]),
    values=st.lists(st.integers(0, 4095), min_size=1, max_size=700),
    pieces=st.lists(st.integers(1, 400), max_size=12),
)
def test_a_scan_survives_any_cutting_into_pieces(width: int, values: list[int], pieces: list[int]) -> None:
    replies, faults = parse(streamed(np.array(values), width=width), pieces)
    assert [is_scan(r) for r in replies] == [True] and not faults
    scan = scan_of(replies[0], Window(1, len(values), short=width == 2))
    assert scan.values.tolist() == values and scan.timestamp_ms == 4711


@given(noise=st.binary(max_size=300), cut=st.integers(1, 2000))
def test_a_scan_after_garbage_and_a_cut_one_is_found_whole(noise: bytes, cut: int) -> None:
    values = np.arange(682) % 4000
    block = streamed(values)
    noise = noise.replace(b"M", b"m")  # else noise may be a reply
    replies, _ = parse(block[:cut] + noise + b"\n" + block)
    assert scan_of(replies[-1], WINDOW).values.tolist() == values.tolist()


@pytest.mark.parametrize("noise", [b"VV", b"\x99PP;\x01", b"12GD0044072501", b"MD0044072501000;"])
def test_garbage_that_holds_an_echo_costs_the_scan_after_it_nothing(noise: bytes) -> None:
    replies, _ = parse(noise + streamed(np.arange(682)))
    assert is_scan(replies[-1]) and scan_of(replies[-1], WINDOW).values.size == 682


@given(position=st.integers(0, 2136), bit=st.integers(0, 7))
def test_a_flipped_bit_never_gives_a_wrong_scan(position: int, bit: int) -> None:
    values = np.arange(682) * 3
    block = bytearray(streamed(values))
    block[position] ^= 1 << bit
    replies, faults = parse(bytes(block) + streamed(values, 4811))
    scans = []
    for reply in replies:
        if is_scan(reply):
            try:
                scans.append(scan_of(reply, WINDOW))
            except DamagedReply as error:
                faults[error.fault] += 1
    assert all(scan.values.tolist() == values.tolist() for scan in scans)
    assert {scan.timestamp_ms for scan in scans} <= {4711, 4811}
    assert any(scan.timestamp_ms == 4811 for scan in scans)
    in_echo = position < len(ECHO)  # it has no sum: the scan is good all the same
    assert len(scans) + sum(faults.values()) >= 2 and (len(scans) == 2 or not in_echo)


@given(data=st.binary(max_size=3000))
def test_no_bytes_break_the_parser(data: bytes) -> None:
    replies, _ = parse(data, [7, 100])
    for reply in replies:
        info_of(reply)


def test_captured_scans(shared_data: Path) -> None:
    for name in "AB":
        data = (shared_data / "scip" / f"gd0044072501_capture_{name}.bin").read_bytes()
        replies, faults = parse(data, [100, 1])
        assert not faults and [(r.command, r.status) for r in replies] == [("GD", "00")]
        scan = scan_of(replies[0], WINDOW)
        ranges = scan.values[scan.values >= 20]
        assert len(scan.values) == 682 and len(ranges) > 300 and ranges.max() <= 5600


def test_captured_answers(shared_data: Path) -> None:
    blocks = []
    for line in (shared_data / "scip" / "other_responses.txt").read_text().splitlines():
        if not line.startswith(("#", " ", "(")):
            blocks += [
                part.strip() for part in line.split("   ") if r"\n\n" in part and part.strip()[0] != "("
            ]
    data = b"".join(block.split(r"\n\n")[0].replace(r"\n", "\n").encode() + b"\n\n" for block in blocks)
    replies, faults = parse(data)
    assert not faults
    assert [(r.echo.decode(), r.status) for r in replies] == [
        ("VV", "00"), ("BM", "02"), ("SCIP2.0", "0E"), ("BM", "00"), ("BM", "02"), ("QT", "00"), ("PP", "00"),
    ]  # fmt: skip
    version, wrong = info_of(replies[0])
    assert version["SERI"] == "H1510998" and wrong == 0
    told = parameters_of(info_of(replies[-1])[0])
    assert (told.model, told.steps_per_turn, told.front_step, told.rpm) == ("UTM-30LX-EW", 1440, 540, 2400)


@pytest.mark.parametrize("missing", ["ARES", "SCAN"])
def test_parameters_that_are_missing_are_named(missing: str) -> None:
    info = {
        "DMIN": "20",
        "DMAX": "5600",
        "ARES": "1024",
        "AMIN": "44",
        "AMAX": "725",
        "AFRT": "384",
        "SCAN": "600",
    }
    del info[missing]
    with pytest.raises(ValueError, match=missing):
        parameters_of(info)


def test_an_old_sensor_s_answer_to_the_upgrade() -> None:
    replies, faults = parse(b"SCIP2.0\n0\n\n")
    assert [(r.echo, r.status) for r in replies] == [(b"SCIP2.0", "00")] and not faults


def test_every_status_has_words() -> None:
    assert "laser" in status.meaning("GD", "10")
    assert "verifies" in status.meaning("MD", "21") and "verifies" in status.meaning("MS", "49")
    assert "hardware" in status.meaning("MD", "50") and "resumed" in status.meaning("MD", "98")
    for code in "ABCDEFGHI":
        assert status.meaning("XX", f"0{code}") != "unknown status"
    assert status.range_code(18) == "strong reflector" and status.range_code(13) == "other error"


@given(first=st.integers(0, 700), length=st.integers(1, 700), cluster=st.integers(1, 99), short=st.booleans())
def test_a_window_knows_the_length_of_its_reply(first: int, length: int, cluster: int, short: bool) -> None:
    window = Window(first, first + length - 1, cluster, short=short)
    assert len(streamed(np.zeros(window.count, np.int64), width=window.width)) == window.reply_bytes
