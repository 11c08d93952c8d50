"""What is accepted as a worker's answer, and what is not."""

import os
import socket
import struct
from dataclasses import replace

import numpy as np
import pytest
from campaign.stub import Disc

from activefail.errors import ActivefailError, BusyError, DamagedError, InputError, SimulationError, StoreError
from activefail.execution.frames import (
    MOST_TEXT,
    BrokenFrameError,
    Frame,
    FrameKind,
    Question,
    decode_frame,
    encode_frame,
    longest_answer,
    pack_answer,
    pack_error,
    pack_text,
    receive,
    request_senders,
    unpack_answer,
    unpack_error,
    unpack_text,
)
from activefail.simulators.interface import RAISED, Results, unanswered

pytestmark = pytest.mark.faults

SECRET, QUESTION, PROCESS, MOST = bytes(range(32)), Question.about(b"a design", bytes(16)), 4711, 100
PAYLOAD = b"an answer"
FRAME = encode_frame(SECRET, QUESTION, PROCESS, FrameKind.ANSWERED, PAYLOAD)


def read(data: bytes, question: Question = QUESTION, process: int | None = PROCESS, most: int = MOST) -> Frame | None:
    return decode_frame(data, SECRET, question, process, most)


def test_a_frame_is_read_as_it_was_written_and_what_follows_it_is_seen() -> None:
    assert read(FRAME) == Frame(FrameKind.ANSWERED, PAYLOAD, PROCESS, False)
    assert read(FRAME + b"\0") == Frame(FrameKind.ANSWERED, PAYLOAD, PROCESS, True)
    assert read(FRAME, process=None) == Frame(FrameKind.ANSWERED, PAYLOAD, PROCESS, False)


def test_a_frame_of_which_a_part_is_missing_is_waited_for() -> None:
    assert [read(FRAME[:length]) for length in range(len(FRAME))] == [None] * len(FRAME)


def test_a_frame_of_which_any_bit_is_wrong_is_refused() -> None:
    for bit in range(8 * len(FRAME)):
        wrong = bytearray(FRAME)
        wrong[bit // 8] ^= 1 << bit % 8
        try:
            # A length that is wrong may ask for more, and then the checksum is wrong.
            assert read(bytes(wrong)) is None
            assert read(bytes(wrong) + bytes(MOST)) is None
        except BrokenFrameError:
            continue
        pytest.fail(f"bit {bit} may be wrong")


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        (
            encode_frame(SECRET, Question.about(b"a design", bytes([1] * 16)), PROCESS, FrameKind.ANSWERED),
            "another design",
        ),
        (encode_frame(SECRET, Question.about(b"?", QUESTION.ticket), PROCESS, FrameKind.ANSWERED), "another design"),
        (encode_frame(SECRET, QUESTION, PROCESS + 1, FrameKind.ANSWERED), "another process"),
        (encode_frame(bytes(32), QUESTION, PROCESS, FrameKind.ANSWERED), "checksum"),
        (encode_frame(SECRET, QUESTION, PROCESS, 9), "kind is unknown"),  # type: ignore[arg-type]
        (b"\0\0\0\5AAAAA", "does not begin"),
        (FRAME[1:], "does not begin"),
        (FRAME[:4] + FRAME, "does not begin"),
        (FRAME[:50] + FRAME, "too long|checksum"),
    ],
    ids=["ticket", "digest", "process", "key", "kind", "junk", "late", "prefix", "part"],
)
def test_what_answers_something_else_or_is_no_frame_is_refused(frame: bytes, says: str) -> None:
    with pytest.raises(BrokenFrameError, match=says):
        read(frame)


def test_no_two_questions_have_the_same_ticket() -> None:
    assert len({Question.about(b"a design").ticket for _ in range(1000)}) == 1000


def test_a_length_beyond_the_bound_is_refused_before_anything_of_it_has_come() -> None:
    frame = encode_frame(SECRET, QUESTION, PROCESS, FrameKind.ANSWERED, bytes(MOST + 1))
    with pytest.raises(BrokenFrameError, match="too long"):
        read(frame[: len(frame) - MOST - 1])


NAN = struct.unpack("<d", b"\1\2\3\4\5\6\xf8\xff")[0]


@pytest.mark.parametrize("margin", [0.1, -0.0, np.inf, NAN, 5e-324])
def test_an_answer_arrives_bit_for_bit(margin: float) -> None:
    results = replace(
        Disc().run(np.array([[0.5, 20.0]])),
        margins=np.array([[margin]]),
        seconds=np.array([0.1]),
        faults={0: "größer \ud800"},
    )
    there = unpack_answer(pack_answer(results), Disc())
    for name in ("outcome", "cause", "margins", "seconds"):
        one, other = getattr(there, name), getattr(results, name)
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    assert there.faults == {0: "größer \\ud800"}
    there = unpack_answer(pack_answer(unanswered(Disc(), 1, RAISED)), Disc())
    assert (there.cause.tolist(), there.faults) == ([RAISED], {})


def test_a_long_text_is_cut_and_is_a_text_still() -> None:
    payload = pack_answer(unanswered(Disc(), 1, RAISED, "ä" * MOST_TEXT))
    assert len(payload) <= longest_answer(Disc())
    assert set(unpack_answer(payload, Disc()).faults[0]) == {"ä"}
    assert len(pack_text("ab" * MOST_TEXT)) == MOST_TEXT


@pytest.mark.parametrize(
    "wrong",
    [
        {"outcome": 2},
        {"outcome": -2},
        {"cause": 3},
        {"cause": -6},
        {"seconds": -1.0},
        {"seconds": np.nan},
        {"seconds": np.inf},
    ],
)
def test_an_answer_that_the_simulator_cannot_give_is_refused(wrong: dict[str, float]) -> None:
    good = Disc().run(np.array([[0.5, 20.0]]))
    kinds = {"outcome": np.int8, "cause": np.int8, "seconds": np.float64}
    results: Results = replace(good, **{name: np.array([value], kinds[name]) for name, value in wrong.items()})
    with pytest.raises(BrokenFrameError, match="out of range"):
        unpack_answer(pack_answer(results), Disc())


def test_an_answer_that_is_too_short_or_no_text_is_refused() -> None:
    payload = pack_answer(Disc().run(np.array([[0.5, 20.0]])))
    for length in range(len(payload)):
        with pytest.raises(BrokenFrameError, match="too short"):
            unpack_answer(payload[:length], Disc())
    with pytest.raises(BrokenFrameError, match="not UTF-8"):
        unpack_answer(payload + b"\xff", Disc())
    with pytest.raises(BrokenFrameError, match="not UTF-8"):
        unpack_text(b"\xff")


@pytest.mark.parametrize("error", [ActivefailError, InputError, StoreError, BusyError, SimulationError])
def test_an_error_of_activefail_arrives_as_what_it_is(error: type[ActivefailError]) -> None:
    there = unpack_error(pack_error(error("space.x: must be 1, got 2.\nAnd more.")))
    assert (type(there), str(there)) == (error, "space.x: must be 1, got 2.\nAnd more.")


def test_an_error_without_a_name_here_arrives_as_the_nearest_and_no_other_class_can_be_named() -> None:
    class SystemExit(SimulationError):  # noqa: N818
        pass

    assert type(unpack_error(pack_error(DamagedError("torn")))) is StoreError
    assert type(unpack_error(pack_error(SystemExit("gone")))) is SimulationError
    for payload in (b"SystemExit 1", b"os.system ls", b""):
        with pytest.raises(BrokenFrameError, match="names no error"):
            unpack_error(payload)


@pytest.mark.skipif(not hasattr(socket, "SO_PASSCRED"), reason="only Linux says who sent a message")
def test_the_kernel_says_which_process_sent_something_and_keeps_two_apart() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        request_senders(ours)
        theirs.sendall(b"parent")
        child = os.fork()
        if child == 0:
            theirs.sendall(b"child")
            os._exit(0)
        os.waitpid(child, 0)
        theirs.sendall(b"parent")
        heard = [receive(ours) for _ in range(3)]
        theirs.close()
        assert heard == [(b"parent", os.getpid()), (b"child", child), (b"parent", os.getpid())]
        assert receive(ours)[0] == b""
