"""The fewest questions that reach many servos of one family, and the fewest packets for writes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from ikservo.hardware.drivers.driver import Driver
from ikservo.hardware.packets.replies import Reply
from ikservo.hardware.packets.span import Span

__all__ = ["gather", "scatter"]


def gather(driver: Driver, spans: Mapping[int, Span]) -> dict[int, Reply]:
    """Ask each servo for its own stretch of memory.

    One sync read where all want the same bytes, else one bulk read where the family has it, else
    a sync read for each kind of bytes, or one servo after the other.
    """
    first = next(iter(spans.values()))
    if driver.can_sync_read and all(s is first or s == first for s in spans.values()):
        return driver.sync_read(tuple(spans), first.address, first.size)
    groups: dict[Span, list[int]] = defaultdict(list)
    for servo_id, span in spans.items():
        groups[span].append(servo_id)
    if len(groups) > 1 and (driver.can_bulk_read(spans) or not driver.can_sync_read):
        return driver.bulk_read(spans)
    replies: dict[int, Reply] = {}
    for span, servo_ids in groups.items():
        replies |= driver.sync_read(servo_ids, span.address, span.size)
    return replies


def scatter(driver: Driver, rows: Mapping[int, tuple[int, bytes]]) -> None:
    """Write to each servo at its own address, all at once where that can be said in one packet."""
    groups: dict[tuple[int, int], dict[int, bytes]] = defaultdict(dict)
    for servo_id, (address, data) in rows.items():
        groups[address, len(data)][servo_id] = data
    if len(groups) > 1 and driver.can_bulk_write:
        driver.bulk_write(rows)
        return
    for (address, _), data_by_id in groups.items():
        driver.sync_write(address, data_by_id)
