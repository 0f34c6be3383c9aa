"""Questions that the vendor's SDK has written before: they repeat, and are sent as they stand."""

from __future__ import annotations

from collections.abc import Callable

from ikservo.hardware.line.port import Port

__all__ = ["Phrasebook"]

_MOST = 64  # more than a program repeats; a line with troubles must not fill memory
_CUT_SHORT = 1  # any code but 0; the exchange makes a lost line of it

Phrase = tuple[int, int, bytes]
"""Id, instruction, parameters."""


class Phrasebook:
    """Sends packets; the SDK writes those that carry values anew, and others the first time only.

    Args:
        port: The line.
        write: Hands a phrase to the vendor's ``txPacket``; returns its result code.
        questions: The instructions whose packets carry no values.
    """

    def __init__(
        self, port: Port, write: Callable[[int, int, bytes], int], questions: frozenset[int]
    ) -> None:
        self._port, self._write, self._questions = port, write, questions
        self._packets: dict[Phrase, bytes] = {}

    def send(self, servo_id: int, instruction: int, parameters: bytes) -> int:
        """Put a packet on the line behind a cleared input; return the SDK's result code."""
        phrase = (servo_id, instruction, parameters)
        packet = self._packets.get(phrase)
        if packet:
            return self._again(packet)
        result = self._write(servo_id, instruction, parameters)
        if result == 0 and instruction in self._questions:
            self._remember(phrase)
        return result

    def _again(self, packet: bytes) -> int:
        self._port.clearPort()
        return 0 if self._port.writePort(packet) == len(packet) else _CUT_SHORT

    def _remember(self, phrase: Phrase) -> None:
        if len(self._packets) >= _MOST:
            self._packets.clear()
        self._packets[phrase] = self._port.sent
