"""Plots of the history on a page: chosen channels, thinned for the screen."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ikservo.apps.page.messages.page_messages import BadMessageError, ShowPlots
from ikservo.apps.page.running.history import Channel, History, HistorySlice
from ikservo.apps.page.server.server import Frame

_MAX_POINTS = 600
_PERIOD_S = 0.2  # least time between two frames
_DIGITS = 3


@dataclass(slots=True)
class _Plot:
    """The plot of a page.

    Attributes:
        channels: The chosen channels.
        span_s: The length of the shown time span.
        stopped: Whether the seconds before the last stop are shown instead of the present.
        sent_s: Time of the last sample that was sent.
        due_s: The time of the next frame.
        shown_stop: The recording of a stop that was sent, if any.
    """

    channels: tuple[Channel, ...]
    span_s: float
    stopped: bool
    sent_s: float = -math.inf
    due_s: float = -math.inf
    shown_stop: HistorySlice | None = None


class PlotFeed:
    """Feed of the channels that each page plots; a page whose plots are closed gets nothing."""

    def __init__(self) -> None:
        self._plots: dict[int, _Plot] = {}

    def choose(self, client_id: int, message: ShowPlots, history: History) -> None:
        """Change what a page plots; an empty choice closes its plots.

        Raises:
            BadMessageError: The joint does not exist, or there has been no stop to plot.
        """
        self.forget(client_id)
        if not message.quantities:
            return
        if message.stopped and history.last_stop is None:
            raise BadMessageError(
                "Nothing has stopped the arm yet.", "Show the present data instead."
            )
        unknown = set(message.joints) - {channel.joint for channel in history.channels}
        if unknown:
            raise BadMessageError(f"The arm has no joint {min(unknown)!r}.", "Reload the page.")
        chosen = tuple(
            channel
            for channel in history.channels
            if channel.quantity in message.quantities
            and (not channel.joint or channel.joint in message.joints)
        )
        self._plots[client_id] = _Plot(chosen, float(message.span_s), message.stopped)

    def forget(self, client_id: int) -> None:
        """Stop sending plots to a page."""
        self._plots.pop(client_id, None)

    def frames(self, client_id: int, history: History, now_s: float) -> list[Frame]:
        """Return new data for a page's plots, at most five times per second."""
        plot = self._plots.get(client_id)
        if plot is None or now_s < plot.due_s:
            return []
        plot.due_s = now_s + _PERIOD_S
        if plot.stopped:
            recording = history.last_stop
            if recording is None or recording is plot.shown_stop:
                return []
            plot.shown_stop = recording
            fields = _first_fields(plot, History.STOP_S) | {"reason": recording.reason}
            return [fields | _samples(plot, recording, 0.0)]
        is_first = math.isinf(plot.sent_s)
        recording = history.since(now_s - plot.span_s if is_first else plot.sent_s)
        fields = _samples(plot, recording, plot.span_s / _MAX_POINTS)
        if is_first:
            return [_first_fields(plot, plot.span_s) | fields]
        return [fields] if fields["times"] else []


def _first_fields(plot: _Plot, span_s: float) -> dict[str, object]:
    """Return the list of channels, which is sent once."""
    series = [
        {"quantity": each.quantity, "unit": each.unit, "joint": each.joint}
        for each in plot.channels
    ]
    return {"series": series, "span_s": span_s, "reason": ""}


def _samples(plot: _Plot, recording: HistorySlice, period_s: float) -> dict[str, object]:
    """Return samples of the chosen channels, at least a period apart."""
    kept: list[int] = []
    for row, time_s in enumerate(recording.times_s.tolist()):
        if time_s - plot.sent_s >= period_s:
            kept.append(row)
            plot.sent_s = time_s
    columns = recording.select(plot.channels)[kept].T.tolist()
    return {
        "kind": "plots",
        "times": [round(time_s, 2) for time_s in recording.times_s[kept].tolist()],
        "values": [
            [(None if math.isnan(value) else round(value, _DIGITS)) for value in column]
            for column in columns
        ],
    }
