"""Dialects against bytes laid out by hand from the published protocols; the CRCs here are bitwise, those tested are not."""

import socket
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorlens_runtime.errors import DataError
from motorlens_runtime.line.dialects import dialect_names, make_dialect, recognise
from motorlens_runtime.line.dialects.binary import CHECKSUMS, Binary, parse_record
from motorlens_runtime.line.dialects.roboclaw import RoboClaw
from motorlens_runtime.line.dialects.stamps import ArrivalStamps, DeviceStamps, RateStamps
from motorlens_runtime.line.dialects.text import Text
from motorlens_runtime.line.dialects.vesc import Vesc

MS = 1_000_000
S = 1_000_000_000


def crc16_bitwise(data: bytes, crc: int = 0) -> int:
    """CRC-16 of polynomial 0x1021 as the RoboClaw manual prints it, a bit at a time."""
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021) & 0xFFFF if crc & 0x8000 else crc << 1 & 0xFFFF
    return crc


def test_checksums_give_the_check_values_of_the_crc_catalogue():
    check = b"123456789"
    values = {name: function(check) for name, (_, function) in CHECKSUMS.items()}
    assert values["crc16_xmodem"] == 0x31C3 == crc16_bitwise(check)
    assert values["crc16_ccitt"] == 0x29B1
    assert values["crc16_modbus"] == 0x4B37
    assert values["crc32"] == 0xCBF43926
    assert values["sum8"] == sum(check) % 256
    assert values["xor8"] == ord("1") ^ ord("2") ^ ord("3") ^ ord("4") ^ ord("5") ^ ord("6") ^ ord("7") ^ ord(
        "8"
    ) ^ ord("9")


# VESC


def vesc_packet(payload: bytes) -> bytes:
    head = (
        bytes((2, len(payload))) if len(payload) < 256 else bytes((3, len(payload) >> 8, len(payload) & 0xFF))
    )
    crc = crc16_bitwise(payload)
    return head + payload + bytes((crc >> 8, crc & 0xFF, 3))


def vesc_values(current: int, duty: int, voltage: int) -> bytes:
    """COMM_GET_VALUES of firmware 3.40, 59 bytes; numbers as on the wire (0.01 A, 0.001, 0.1 V)."""
    return (
        bytes((4,)) + struct.pack(">hhiiii", 312, 455, current, 123, 0, 0) + struct.pack(">hih", duty, -4200, voltage)
        + struct.pack(">iiiiii", 1, 2, 3, 4, 5, 6) + bytes((0,)) + struct.pack(">i", 7)
    )  # fmt: skip


def test_vesc_asks_with_the_bytes_everybody_asks_with():
    # COMM_GET_VALUES as it stands in countless sketches: 02 01 04 40 84 03.
    dialect = Vesc(poll_Hz=100.0, selective=False)
    assert dialect.request(0) == bytes.fromhex("020104408403")
    assert dialect.request(20 * MS) == b""  # no reply yet
    assert dialect.request(200 * MS) == bytes.fromhex("020104408403")  # given up
    dialect.feed(vesc_packet(vesc_values(0, 0, 240)), 201 * MS)
    assert dialect.request(205 * MS) == b""  # not due
    assert dialect.request(210 * MS) != b""
    assert Vesc(poll_Hz=0).request(0) == b""


def test_vesc_reply_becomes_terminal_voltage_and_signed_current():
    dialect = Vesc()
    forward = dialect.feed(vesc_packet(vesc_values(1234, 500, 241)), 1 * S)
    assert forward.voltage_V == pytest.approx([0.5 * 24.1])
    assert forward.current_A == pytest.approx([12.34])
    assert forward.time_ns.tolist() == [S]
    backward = dialect.feed(vesc_packet(vesc_values(1234, -500, 241)), 2 * S)
    assert backward.voltage_V == pytest.approx([-12.05])
    assert backward.current_A == pytest.approx(
        [-12.34]
    )  # the firmware says drawing; the duty cycle says which way
    braking = dialect.feed(vesc_packet(vesc_values(-1234, -500, 241)), 3 * S)
    assert braking.current_A == pytest.approx([12.34])


def test_vesc_selective_reply_to_its_own_question():
    dialect = Vesc(selective=True)
    question = dialect.request(0)
    assert question == vesc_packet(bytes.fromhex("32 00000144"))
    reply = vesc_packet(bytes.fromhex("32 00000144") + struct.pack(">ihh", -250, 1000, 126))
    samples = dialect.feed(reply, S)
    assert (samples.voltage_V.tolist(), samples.current_A.tolist()) == ([12.6], [-2.5])


def test_vesc_finds_packets_among_rubbish_and_other_messages():
    dialect = Vesc()
    good = [vesc_packet(vesc_values(100 * k, 900, 240)) for k in range(1, 6)]
    damaged = bytearray(vesc_packet(vesc_values(9999, 900, 240)))
    damaged[20] ^= 0x10
    version = vesc_packet(bytes((0, 5, 3)) + b"410\0" + bytes(280))  # another message, long form
    wire = (
        b"\x02\xff\x03"
        + good[0]
        + bytes(damaged)
        + good[1]
        + version
        + good[2]
        + b"\x00\x02"
        + good[3]
        + good[4]
    )
    got = []
    for at in range(0, len(wire), 7):
        got += dialect.feed(wire[at : at + 7], S + at).current_A.tolist()
    # A start byte in rubbish may wait for as many bytes as it claims; after that, everything is found.
    got += dialect.feed(bytes(600), 2 * S).current_A.tolist()
    assert got == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert dialect.bad_frames >= 1


# RoboClaw


def roboclaw_reply(command: int, values: bytes, address: int = 0x80) -> bytes:
    return values + crc16_bitwise(bytes((address, command)) + values).to_bytes(2, "big")


def answer(question: bytes, supply: int, pwm: tuple[int, int], current: tuple[int, int]) -> bytes:
    address, command = question
    values = {24: struct.pack(">H", supply), 48: struct.pack(">hh", *pwm), 49: struct.pack(">hh", *current)}[
        command
    ]
    return roboclaw_reply(command, values, address)


def test_roboclaw_asks_three_questions_and_makes_one_sample():
    dialect = RoboClaw(motor=2, poll_Hz=50.0)
    asked = []
    for step in range(3):
        question = dialect.request(step * 5 * MS)
        asked.append(question)
        assert dialect.request(step * 5 * MS + 1) == b""
        samples = dialect.feed(answer(question, 243, (0, -16384), (5, 321)), step * 5 * MS + 2 * MS)
    assert sorted(asked) == [bytes((0x80, 24)), bytes((0x80, 48)), bytes((0x80, 49))]
    assert samples.voltage_V == pytest.approx([24.3 * -16384 / 32767])
    assert samples.current_A == pytest.approx([-3.21])  # drawn, while the PWM runs backwards
    assert dialect.request(16 * MS) == b""  # 50 rounds a second
    assert dialect.request(20 * MS) != b""


def test_roboclaw_signed_current_is_left_alone():
    dialect = make_dialect("roboclaw", {"poll_Hz": "0", "current": "signed", "address": "0x82"})
    wire = b"".join(answer(bytes((0x82, c)), 120, (-32767, 0), (-150, 0)) for c in (24, 48, 49))
    samples = dialect.feed(wire, S)
    assert (samples.voltage_V.tolist(), samples.current_A.tolist()) == ([-12.0], [-1.5])


def test_roboclaw_forgets_a_round_that_lost_an_answer():
    dialect = RoboClaw(poll_Hz=50.0)
    dialect.feed(answer(dialect.request(0), 240, (1000, 0), (10, 0)), MS)
    assert dialect.request(2 * MS)
    late = dialect.request(100 * MS)  # the second answer never came: everything starts anew
    assert late == bytes((0x80, 24))
    for step in range(3):
        samples = dialect.feed(b"\x17" + answer(late, 120, (32767, 0), (200, 0)), (101 + step) * MS)
        late = dialect.request((102 + step) * MS)
    assert (samples.voltage_V.tolist(), samples.current_A.tolist()) == ([12.0], [2.0])
    assert dialect.bad_frames >= 2


# A record of one's own

RECORD = {
    "record": {"sync": "AA 55", "byte_order": "big", "checksum": "crc16_modbus"},
    "field": [
        {"type": "u32", "quantity": "time", "unit": "us"},
        {"type": "i16", "quantity": "voltage", "unit": "mV", "scale": 10},
        {"type": "skip", "count": 3},
        {"type": "i16", "quantity": "current", "unit": "mA", "offset": -500},
        {"type": "u8"},
    ],
}


def record_bytes(time_us: int, voltage: int, current: int, *, checksum: bool = True) -> bytes:
    body = struct.pack(">Ih3xhB", time_us, voltage, current, 0x55)
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return b"\xaa\x55" + body + (crc.to_bytes(2, "big") if checksum else b"")


def test_record_is_scaled_and_stamped_by_the_device_clock_across_its_wrap():
    dialect = Binary(parse_record(RECORD, "r.toml"))
    start = 2**32 - 5_000
    wire = b"".join(record_bytes((start + 1000 * k) % 2**32, 1200 + k, 1500) for k in range(10))
    samples = dialect.feed(wire, 5 * S)
    assert samples.voltage_V == pytest.approx([(1200 + k) * 0.01 for k in range(10)])
    assert samples.current_A == pytest.approx([1.0] * 10)
    assert np.diff(samples.time_ns).tolist() == [MS] * 9
    assert samples.time_ns[-1] == 5 * S


def test_record_resynchronises_and_takes_no_damaged_one():
    dialect = Binary(parse_record(RECORD, "r.toml"))
    good = [record_bytes(1000 * k, 100 + k, 0) for k in range(200)]
    rng = np.random.default_rng(5)
    wire = bytearray()
    expected = []
    for k, piece in enumerate(good):
        kind = int(rng.integers(5))
        if kind == 0:
            broken = bytearray(piece)
            broken[int(rng.integers(len(broken)))] ^= 1 << int(rng.integers(8))
            wire += broken
        elif kind == 1:
            wire += piece[: int(rng.integers(1, len(piece)))]
        else:
            wire += rng.bytes(int(rng.integers(4))) + piece
            expected.append(round((100 + k) * 0.01, 6))
    got = []
    for at in range(0, len(wire), 13):
        got += dialect.feed(bytes(wire[at : at + 13]), at * MS).voltage_V.round(6).tolist()
    assert got == expected
    assert dialect.bad_frames > 20


def test_record_without_a_checksum_wants_two_marks():
    document = {**RECORD, "record": {**RECORD["record"], "checksum": "none"}}
    dialect = Binary(parse_record(document, "r.toml"))
    wire = b"\x00\xaa\x55\x01" + b"".join(record_bytes(1000 * k, k, 0, checksum=False) for k in range(6))
    assert dialect.feed(wire, S).voltage_V == pytest.approx([0.01 * k for k in range(6)])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"record": {"sync": ""}}, "sync is empty"),
        ({"record": {"sync": "AA", "checksum": "crc16_modbuss"}}, "did you mean 'crc16_modbus'"),
        ({"record": {"sync": "AA", "bytes": 1}}, "unknown key 'bytes'"),
        ({"field": [{"type": "i16", "quantity": "current", "unit": "A"}]}, "no voltage"),
        ({"field": [{"type": "i17"}]}, "type 'i17'"),
        ({"field": [{"type": "i16", "quantity": "voltage", "unit": "furlong"}]}, "unknown unit 'furlong'"),
        ({"record": {"sync": "GG"}}, "not understood"),
    ],
)
def test_record_description_that_is_wrong_says_where(change, message):
    with pytest.raises(DataError, match=message) as caught:
        parse_record({**RECORD, **change}, "r.toml")
    assert str(caught.value).startswith("r.toml")


def test_duty_in_percent_times_supply():
    document = {
        "record": {"sync": "7E", "rate_Hz": 100},
        "field": [
            {"type": "i8", "quantity": "duty", "unit": "%"},
            {"type": "u16", "quantity": "supply_voltage", "unit": "mV"},
            {"type": "f32", "quantity": "current", "unit": "A"},
        ],
    }
    dialect = Binary(parse_record(document, "r.toml"))
    wire = b"".join(b"\x7e" + struct.pack("<bHf", -50, 24000, 0.25) for _ in range(5)) + b"\x7e"
    samples = dialect.feed(wire, S)
    assert samples.voltage_V == pytest.approx([-12.0] * 5)
    assert np.diff(samples.time_ns).tolist() == [10 * MS] * 4


# Text


def test_text_reads_csv_json_and_pairs_alike():
    expected = [(12.0, 0.5), (12.5, -0.25)]
    lines = {
        "csv": "t[s],v[V],i[A]\n0.000,12.0,0.5\n0.001,12.5,-0.25\n",
        "other units and separators": "time_ms;voltage_mV;note;current_mA\n0;12000;x;500\n1;12500;;-250\n",
        "tabs, heading with blanks": "Time (s)\tVoltage (V)\tCurrent (A)\r\n0\t12\t.5\r\n1e-3\t12.5\t-2.5e-1\r\n",
        "json": '{"t": 0, "v[V]": 12.0, "i[A]": 0.5}\n{"t": 0.001, "v[V]": 12.5, "i[A]": -0.25}\n',
        "nested json": '{"a": {"time_us": 0, "m": {"voltage": 12, "current": 0.5}}, "on": true}\n'
        '{"a": {"time_us": 1000, "m": {"voltage": 12.5, "current": -0.25}}, "on": true}\n',
        "pairs": "t:0 voltage_V:12.0 current_A:0.5\nt:0.001 voltage_V:12.5 current_A:-0.25\n",
        "duty": "time_s,duty_%,supply_voltage_V,current_A\n0,50,24,0.5\n0.001,50,25,-0.25\n",
    }
    for name, text in lines.items():
        samples = Text().feed(text.encode(), 7 * S)
        assert list(zip(samples.voltage_V.tolist(), samples.current_A.tolist(), strict=True)) == expected, (
            name
        )
        assert np.diff(samples.time_ns).tolist() == [MS], name


def test_text_without_a_heading_is_told_its_columns():
    dialect = make_dialect("text", {"columns": "voltage_V,current_A,speed_rpm", "rate_Hz": "200"})
    samples = dialect.feed(b"5\t1\t0\n5.5\t1.5\t0\n# a comment\nrubbish\n6\t2\t9\n", S)
    assert samples.voltage_V.tolist() == [5.0, 5.5, 6.0]
    assert np.diff(samples.time_ns).tolist() == [5 * MS] * 2
    assert dialect.bad_frames == 1


def test_text_starts_anew_with_a_new_heading():
    dialect = Text()
    text = b"v[V],i[A]\n1,2\nbroken,\n3,4,5\ni[A],v[V],t[s]\n6,7,0.0\n"
    samples = dialect.feed(text, S)
    assert (samples.voltage_V.tolist(), samples.current_A.tolist()) == ([1.0, 7.0], [2.0, 6.0])
    assert dialect.bad_frames == 2


def test_a_heading_without_a_time_after_one_with_it_does_not_step_back():
    dialect = Text()
    first = dialect.feed(b"t[s],v[V],i[A]\n4,12,1\n0.001,12,1\n", 5 * MS)
    second = dialect.feed(b"v[V],i[A]\n12,1\n", 6 * MS)
    assert second.time_ns[0] >= first.time_ns[-1]


def test_what_a_line_speaks_is_recognised():
    from motorlens_runtime.line import framing

    frames = b"".join(
        framing.samples_frame(np.zeros((5, 2), dtype=np.int16), schema=1, sequence=k, t0_us=5 * k)
        for k in range(4)
    )
    assert recognise(frames) == "frames"
    assert recognise(b"t[s],v[V],i[A]\n0.1,2,3\n") == "text"
    assert recognise("2;0.1µs;Ω\n".encode() * 3) == "text"
    assert recognise(b"") is None
    assert recognise(vesc_packet(vesc_values(0, 0, 0)) * 3) != "text"


# CAN


DBC = """VERSION ""
BO_ 256 Drive: 8 ECU
 SG_ Current : 0|16@1- (0.01,0) [0|0] "A" Vector__XXX
 SG_ Duty : 16|16@1- (0.1,0) [0|0] "%" Vector__XXX
BO_ 2147488000 Bus: 2 ECU
 SG_ Supply : 7|16@0+ (1,0) [0|0] "mV" Vector__XXX
"""


def test_can_reads_what_a_bus_carries(tmp_path):
    pytest.importorskip("cantools", reason="the extra `can` is not installed")
    can = pytest.importorskip("can", reason="python-can is not installed")
    from motorlens_runtime.line.dialects.can import frame_bytes

    path = tmp_path / "drive.dbc"
    path.write_text(DBC)
    options = {
        "dbc": str(path),
        "current": "Drive.Current",
        "duty": "Drive.Duty",
        "supply_voltage": "Bus.Supply",
    }
    dialect = make_dialect("can", options)
    bus = can.Bus(interface="virtual", channel="motorlens", receive_own_messages=True)
    current = struct.pack("<hh", -150, -500)
    sent = [
        can.Message(arbitration_id=256, data=current, is_extended_id=False),  # no supply voltage known yet
        can.Message(
            arbitration_id=2147488000 & 0x1FFFFFFF, data=struct.pack(">H", 24000), is_extended_id=True
        ),
        can.Message(arbitration_id=256, data=current + bytes(4), is_extended_id=False),
        can.Message(arbitration_id=77, data=bytes(8), is_extended_id=False),
        can.Message(arbitration_id=256, data=b"\x01", is_extended_id=False),  # too short to hold its signals
    ]
    try:
        for message in sent:
            bus.send(message)
        frames = [bus.recv(1.0) for _ in sent]
    finally:
        bus.shutdown()
    wire = b"".join(frame_bytes(f.arbitration_id, bytes(f.data), extended=f.is_extended_id) for f in frames)
    got = dialect.feed(wire, S)
    assert got.voltage_V[:1] == pytest.approx([-12.0])
    assert got.current_A[:1] == pytest.approx([-1.5])
    assert not len(dialect.feed(frame_bytes(256, current), 10 * S))  # the supply voltage is too old


def test_can_frame_is_the_kernels():
    from motorlens_runtime.line.dialects import can

    assert (can.CLASSIC.size, can.FLEXIBLE.size) == (16, 72)
    if hasattr(socket, "CAN_EFF_FLAG"):
        assert can.EXTENDED_FLAG == socket.CAN_EFF_FLAG


# All of them


def every_dialect(tmp_path):
    record = tmp_path / "record.toml"
    fields = (("i8", "voltage", "V"), ("f64", "current", "A"), ("f64", "time", "s"))
    table = "".join(f'[[field]]\ntype="{t}"\nquantity="{q}"\nunit="{u}"\n' for t, q, u in fields)
    record.write_text(f'[record]\nsync = "AA"\n{table}')
    options = {"binary": {"file": str(record)}, "text": {"columns": "t,v,i"}}
    # CAN has frames of its own instead of a stream; ours have `test_link` and `test_framing`.
    names = [name for name in dialect_names() if name not in ("can", "frames")]
    return {name: make_dialect(name, options.get(name, {})) for name in names}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("dialects")


pieces = st.one_of(
    st.binary(max_size=200),
    st.sampled_from(
        [
            vesc_packet(vesc_values(10, 500, 240)),
            b"\x03\x01\xff",
            b"\xaa\x01" + struct.pack("<dd", 1.0, 2.0),
            b"\xaa" + struct.pack("<bdd", 5, float("inf"), 1e300),
            roboclaw_reply(24, b"\x00\xf0"),
            b"1,2,3\n",
            b"{" * 3000 + b"\n",
            b'{"v": 1e999, "i": NaN, "t": -1e400}\n',
            b'{"v": %d, "i": 1}\n' % 10**400,
            b"t,v,i\n",
            b"nan,nan,nan\n1e18,1,1\n",
            b"t:1 v:2 i:3\n",
        ]
    ),
)


@pytest.mark.fit
@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(pieces, st.integers(0, 2 * S)), max_size=12))
def test_no_dialect_raises_runs_backwards_or_grows_on_any_bytes(folder, chunks):
    for name, dialect in every_dialect(folder).items():
        last, now = -(2**63), 0
        for data, wait in chunks:
            now += wait
            dialect.request(now)
            samples = dialect.feed(data, now)
            assert len(samples.time_ns) == len(samples.voltage_V) == len(samples.current_A), name
            assert (np.diff(samples.time_ns) >= 0).all(), name
            if len(samples):
                assert last <= samples.time_ns[0], name
                assert samples.time_ns[-1] <= now + 50 * MS, name
                last = int(samples.time_ns[-1])
            assert len(dialect._rest) <= 4200, name
        assert dialect.bytes_seen == sum(len(data) for data, _ in chunks)


@pytest.mark.fit
@settings(max_examples=100, deadline=None)
@given(st.data())
def test_how_bytes_are_cut_changes_no_sample(data):
    wire = b"x\n" + b"".join(b"%d,%d\n" % (k, -k) for k in range(20))
    packets = b"\x02" + b"".join(vesc_packet(vesc_values(k, 10 * k, 240)) for k in range(1, 12)) + bytes(300)
    records = b"\xaa" + b"".join(record_bytes(1000 * k, k, k) for k in range(20))
    cases = [
        (lambda: make_dialect("text", {"columns": "voltage_V,current_A"}), wire),
        (lambda: Vesc(poll_Hz=0), packets),
        (lambda: Binary(parse_record(RECORD, "r")), records),
    ]
    for make, stream in cases:
        whole = make().feed(stream, S)
        cut = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
        dialect = make()
        parts = [dialect.feed(stream[a:b], S) for a, b in zip([0, *cut], [*cut, len(stream)], strict=True)]
        assert np.concatenate([p.voltage_V for p in parts]).tolist() == whole.voltage_V.tolist()
        assert np.concatenate([p.current_A for p in parts]).tolist() == whole.current_A.tolist()


def test_unknown_dialects_and_options_are_named():
    with pytest.raises(DataError, match="did you mean 'vesc'"):
        make_dialect("vesk")
    with pytest.raises(DataError, match="no option 'pol_Hz'; did you mean 'poll_Hz'"):
        make_dialect("vesc", {"pol_Hz": "10"})
    with pytest.raises(DataError, match="motor=3"):
        make_dialect("roboclaw", {"motor": "3"})
    with pytest.raises(DataError, match="needs file"):
        make_dialect("binary")


# Stamps


@pytest.mark.fit
def test_a_drifting_device_is_followed_without_steps():
    """A clock 0.4 % slow, arrival jittering by 2 ms: after an hour the stamps are right, and no period is 2 % off."""
    rng = np.random.default_rng(1)
    stamps = DeviceStamps(modulus_ns=2**32 * 1000)
    all_times = []
    for block in range(36_000):
        true_ns = block * 100 * MS + np.arange(10) * 10 * MS
        device = (true_ns * 0.996).astype(np.int64) % (2**32 * 1000)
        all_times.append(stamps.host_times(device, int(true_ns[-1] + rng.integers(0, 2 * MS))))
    times = np.concatenate(all_times)
    # The lag of a tracker of slew 1 % behind a drift of 0.4 % is within the jitter.
    assert abs(times[-1] - (35_999 * 100 * MS + 90 * MS)) < 5 * MS
    steps = np.diff(times)[1000:]
    assert 0.985 * 10 * MS < steps.min() < steps.max() < 1.015 * 10 * MS


def test_a_restart_goes_on_by_the_hosts_clock_and_a_gap_keeps_its_length():
    stamps = DeviceStamps()
    first = stamps.host_times(np.arange(1, 11) * 100 * MS, 100 * S)
    assert first.tolist() == [100 * S - (9 - k) * 100 * MS for k in range(10)]
    after_gap = stamps.host_times(np.array([61 * S], dtype=np.int64), 160 * S)
    assert after_gap.tolist() == [160 * S]
    after_restart = stamps.host_times(np.array([0, 100 * MS], dtype=np.int64), 170 * S)
    assert after_restart.tolist() == [170 * S - 100 * MS, 170 * S]
    wild = stamps.host_times(np.array([2**61, 200 * MS], dtype=np.int64), 171 * S)
    assert wild[-1] <= 171 * S + 50 * MS
    assert (
        stamps.host_times(np.array([300 * MS], dtype=np.int64), 171 * S + 100 * MS)[0] <= 171 * S + 150 * MS
    )


def test_samples_without_a_clock_are_spread_as_they_came():
    arrival = ArrivalStamps()
    assert arrival.host_times(1, S).tolist() == [S]
    assert arrival.host_times(4, S + 40 * MS).tolist() == [S + 10 * MS * k for k in (1, 2, 3, 4)]
    late = arrival.host_times(2, 60 * S)
    assert late[1] == 60 * S and 60 * S - late[0] <= 40 * MS
    rate = RateStamps(100.0)
    blocks = [rate.host_times(10, (k + 1) * 100 * MS) for k in range(50)]
    assert set(np.diff(np.concatenate(blocks)).tolist()) == {10 * MS}
