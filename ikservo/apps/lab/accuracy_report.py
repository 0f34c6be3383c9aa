"""Report the figures of an accuracy test as JSON values and as one page of HTML."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ikservo.apps.lab.accuracy_test import (
    STANDARD_CYCLES,
    STANDARD_DRIFT_S,
    STANDARD_PATH_CYCLES,
    AccuracyTest,
    PoseResult,
    TestSettings,
)
from ikservo.kinematics.arrays import Matrix, Vector

Fields = Mapping[str, Any]

MEASURED_BY = (
    "Measured with the arm's own joint sensors: bending, backlash behind the sensor and wrong "
    "calibration are not in these figures. Use them to compare arms and settings; do not compare "
    "them with figures of an external measuring device."
)

TOUCHED = (
    "Measured by hand with the tip on known points and torque off. The figures include errors of "
    "calibration, links, backlash and the hand, but not of the motors."
)


def accuracy_fields(test: AccuracyTest, settings: TestSettings) -> dict[str, Any]:
    """Return the measurements as JSON values: metres, seconds, base frame."""
    cube, drift = test.cube, test.drift
    return {
        "measured_by": "joints",
        "cube": {
            "center_m": cube.center_m.tolist(),
            "edge_m": cube.edge_m,
            "normal": cube.normal.tolist(),
        },
        "settings": {
            "cycles": settings.cycles,
            "path_cycles": settings.path_cycles,
            "drift_s": settings.drift_s,
            "parts": list(settings.parts),
            "is_standard": settings.is_standard,
        },
        "top_speed_m_s": test.top_speed_m_s or None,
        "poses": _pose_fields(test.poses),
        "directions": [
            {
                "name": pose.name,
                "cycles": min(len(points) for points in pose.attained_m),
                "vap_m": pose.vap_m,
            }
            for pose in test.directions
        ],
        "paths": [
            {
                "shape": path.shape,
                "speed_percent": path.speed_percent,
                "tool_speed_m_s": path.tool_speed_m_s,
                "cycles": len(path.attained_m),
                "at_m": path.at_m,
                "rt_m": path.rt_m,
                "deviations_m": path.deviations_m.tolist(),
            }
            for path in test.paths
        ],
        "drift": None
        if drift is None or not drift.groups
        else {
            "name": drift.name,
            "dap_m": drift.dap_m,
            "drp_m": drift.drp_m,
            "times_s": drift.times_s,
            "ap_m": [group.ap_m for group in drift.groups],
            "rp_m": [group.rp_m for group in drift.groups],
        },
    }


def touched_poses(tips: Iterable[tuple[str, Vector, Vector]]) -> list[PoseResult]:
    """Group touches of known points, each with name, position (3,) and tip (3,), metres.

    Points are in the base frame; errors include backlash, bending and errors of the hand.
    """
    found: dict[str, PoseResult] = {}
    for name, point_m, tip_m in tips:
        found.setdefault(name, PoseResult(name, point_m)).attained_m.append(tip_m)
    return list(found.values())


def touched_fields(poses: Sequence[PoseResult]) -> dict[str, Any]:
    """Return the measurements from touches, with the keys of ``accuracy_fields``."""
    nothing: dict[str, Any] = {"cube": None, "settings": None, "top_speed_m_s": None}
    rest: dict[str, Any] = {"directions": [], "paths": [], "drift": None}
    return {"measured_by": "touches", **nothing, "poses": _pose_fields(poses), **rest}


def _pose_fields(poses: Sequence[PoseResult]) -> list[dict[str, Any]]:
    return [
        {
            "name": pose.name,
            "target_m": pose.target_m.tolist(),
            "cycles": len(pose.attained_m),
            "ap_m": pose.ap_m,
            "rp_m": pose.rp_m,
            "attained_m": np.array(pose.attained_m).tolist(),
        }
        for pose in poses
        if pose.attained_m
    ]


def summary_rows(fields: Fields) -> list[tuple[str, str, str, str]]:
    """Return the figures as rows: quantity, place, value, cycles."""
    rows: list[tuple[str, str, str, str]] = []
    for pose in fields["poses"]:
        rows.append(("AP", pose["name"], _mm(pose["ap_m"]), str(pose["cycles"])))
        if pose["rp_m"] is not None:
            rows.append(("RP", pose["name"], _mm(pose["rp_m"]), str(pose["cycles"])))
    rows += [("vAP", d["name"], _mm(d["vap_m"]), str(d["cycles"])) for d in fields["directions"]]
    for path in fields["paths"]:
        where = (
            f"{path['shape']}, {path['speed_percent']} %, {1000 * path['tool_speed_m_s']:.0f} mm/s"
        )
        rows.append(("AT", where, _mm(path["at_m"]), str(path["cycles"])))
        rows.append(("RT", where, _mm(path["rt_m"]), str(path["cycles"])))
    drift = fields["drift"]
    if drift is not None:
        where = f"{drift['name']}, {_duration(drift['times_s'][-1])}"
        cycles = str(10 * len(drift["times_s"]))
        rows.append(("dAP", where, _mm(drift["dap_m"]), cycles))
        rows.append(("dRP", where, _mm(drift["drp_m"]), cycles))
    return rows


def statements(fields: Fields) -> list[str]:
    """Return the notes for a comparison: the method, and deviations from the standard."""
    if fields["measured_by"] == "touches":
        found = [TOUCHED]
    else:
        found = [MEASURED_BY, *_shortened(fields["settings"])]
        edge_m = fields["cube"]["edge_m"]
        if edge_m < 0.25:
            found.append(
                f"The edge of the cube is {1000 * edge_m:.0f} mm, the largest that fits; "
                "the smallest in the standard is 250 mm."
            )
    if fields["simulated"]:
        found.append("The arm was simulated.")
    if fields["stopped"]:
        found.append(f"Not complete: {fields['stopped']}")
    return found


def _shortened(settings: Fields) -> list[str]:
    shorter: list[str] = []
    cycles, path_cycles, drift_s = (settings[key] for key in ("cycles", "path_cycles", "drift_s"))
    if cycles < STANDARD_CYCLES:
        shorter.append(f"{cycles} cycles of poses instead of {STANDARD_CYCLES}")
    if path_cycles < STANDARD_PATH_CYCLES:
        shorter.append(f"{path_cycles} cycles of paths instead of {STANDARD_PATH_CYCLES}")
    if "drift" in settings["parts"] and drift_s < STANDARD_DRIFT_S:
        shorter.append(f"drift over {_duration(drift_s)} instead of an hour")
    return [f"Shorter than ISO 9283 asks for: {'; '.join(shorter)}."] if shorter else []


def accuracy_page(fields: Fields) -> str:
    """Return the report as one self-contained page: figures, plots, and the JSON itself."""
    rows = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
        for row in summary_rows(fields)
    )
    facts = "".join(
        f"<dt>{html.escape(name)}</dt><dd>{html.escape(text)}</dd>"
        for name, text in _facts(fields).items()
    )
    notes = "".join(f"<li>{html.escape(text)}</li>" for text in statements(fields))
    title = html.escape(f"{fields['title']}: accuracy test")
    data = json.dumps(fields, ensure_ascii=False).replace("</", "<\\/")
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>'
        f"<body><h1>{title}</h1><dl>{facts}</dl><ul>{notes}</ul>"
        f'<div class="headline">{_headline(fields)}</div>'
        f"<section>{''.join(_line_plots(fields))}</section>"
        f"<section>{''.join(_pose_plots(fields))}</section>"
        "<h2>All figures</h2><table><thead><tr><th>Quantity</th><th>Where</th><th>Value</th>"
        f"<th>Cycles</th></tr></thead><tbody>{rows}</tbody></table><p>{_LEGEND}</p>"
        f'<script type="application/json" id="data">{data}</script></body></html>\n'
    )


_LEGEND = (
    "AP: distance of the mean attained point from the commanded one. RP: mean distance from that "
    "mean plus three standard deviations. vAP: largest distance between the means of approaches "
    "from different directions. AT, RT: largest AP and RP of points along a path. dAP, dRP: "
    "largest change of AP and RP over time. All to ISO 9283:1998, positions only."
)
_STYLE = """
:root{color-scheme:light dark;--ink:#1c2430;--dim:#66707f;--line:#d5dae1;--paper:#fff;
--a:#1f6fd1;--b:#d1691f;--c:#2c8f57}
@media(prefers-color-scheme:dark){:root{--ink:#e8ebf0;--dim:#9aa4b3;--line:#394251;--paper:#12161d;
--a:#6aaeff;--b:#ffa45c;--c:#6fd39a}}
body{font:15px/1.45 system-ui,sans-serif;color:var(--ink);background:var(--paper);
max-width:60rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin:0 0 .8rem}h2{font-size:1.1rem;margin:2rem 0 .5rem}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.1rem 1rem;margin:0 0 1rem}
dt{color:var(--dim)}dd{margin:0}ul{padding-left:1.1rem;color:var(--dim)}
.headline{display:flex;flex-wrap:wrap;gap:1rem;margin:1.2rem 0}
.headline div{border:1px solid var(--line);border-radius:.5rem;padding:.5rem .9rem;min-width:8rem}
.headline b{display:block;font-size:1.4rem;font-variant-numeric:tabular-nums}
.headline span{color:var(--dim);font-size:.85rem}
section{display:grid;grid-template-columns:repeat(auto-fit,minmax(20rem,1fr));gap:1.2rem;
margin-bottom:1.2rem}
@media(max-width:30rem){.headline{display:grid;grid-template-columns:1fr 1fr;gap:.5rem}
.headline div{min-width:0}th,td{padding:.2rem .3rem}}
figure{margin:0}figcaption{font-size:.85rem;color:var(--dim)}svg{width:100%;height:auto}
svg text{fill:var(--dim);font:11px system-ui,sans-serif}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:.2rem .6rem;border-bottom:1px solid var(--line)}
td:nth-child(3){white-space:nowrap}
td:nth-child(3),td:nth-child(4),th:nth-child(3),th:nth-child(4){text-align:right}
p{color:var(--dim);font-size:.9rem}
"""


def _facts(fields: Fields) -> dict[str, str]:
    facts = {
        "Arm": f"{fields['title']} ({fields['arm']})",
        "Date": fields["date"],
        "Software": f"ikservo {fields['version']}",
    }
    if fields["cube"] is not None:
        center = ", ".join(f"{x:.3f}" for x in fields["cube"]["center_m"])
        facts["Cube"] = f"{1000 * fields['cube']['edge_m']:.0f} mm, centred at ({center}) m"
    if fields["top_speed_m_s"]:
        facts["100 % speed"] = (
            f"{1000 * fields['top_speed_m_s']:.0f} mm/s, as fast as the joints allow"
        )
    if fields["note"]:
        facts["Note"] = fields["note"]
    return facts


def _headline(fields: Fields) -> str:
    paths = fields["paths"]
    boxes = {
        "pose accuracy AP, worst": [pose["ap_m"] for pose in fields["poses"]],
        "pose repeatability RP, worst": [pose["rp_m"] for pose in fields["poses"]],
        "multi-directional variation vAP, worst": [each["vap_m"] for each in fields["directions"]],
        "path accuracy AT, worst": [path["at_m"] for path in paths],
        "path repeatability RT, worst": [path["rt_m"] for path in paths],
        "drift dAP": [fields["drift"]["dap_m"]] if fields["drift"] else [],
    }
    known = {name: [v for v in values if v is not None] for name, values in boxes.items()}
    return "".join(
        f"<div><b>{_mm(max(values))}</b><span>{name}</span></div>"
        for name, values in known.items()
        if values
    )


def _line_plots(fields: Fields) -> Iterable[str]:
    for shape in ("line", "circle"):
        paths = [path for path in fields["paths"] if path["shape"] == shape]
        if paths:
            series = [
                (
                    f"{path['speed_percent']} %",
                    np.linspace(0.0, 100.0, len(path["deviations_m"])).tolist(),
                    [1000.0 * value for value in path["deviations_m"]],
                    colour,
                )
                for path, colour in zip(paths, _COLOURS, strict=False)
            ]
            text = f"The {shape}: distance of the mean path from the commanded one, by speed"
            yield _line_plot(text, series, ("% of the path", "mm"))
    drift = fields["drift"]
    if drift is not None and len(drift["times_s"]) > 1:
        minutes = [time_s / 60.0 for time_s in drift["times_s"]]
        values = [1000.0 * value for value in drift["ap_m"]]
        series = [("AP", minutes, values, "var(--a)")]
        yield _line_plot(
            f"Drift at {drift['name']}: pose accuracy over time", series, ("minutes", "mm")
        )


def _pose_plots(fields: Fields) -> Iterable[str]:
    about = "the touched point" if fields["measured_by"] == "touches" else "the commanded one"
    off_mm = [
        1000.0 * np.subtract(pose["attained_m"], pose["target_m"]) for pose in fields["poses"]
    ]
    reach = _round_up(max((float(np.abs(off).max()) for off in off_mm), default=0.0))
    for pose, off in zip(fields["poses"], off_mm, strict=True):
        # The attained points around their target, from above and from the side.
        text = f"{pose['name']}: attained points around {about}"
        above = _scatter(0, ("x", "y"), off[:, [0, 1]], reach)
        side = _scatter(170, ("x", "z"), off[:, [0, 2]], reach)
        yield _figure(above + side, f"{text}, from above and from the side", 172)


_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 340, 230, 40, 30
_COLOURS = ("var(--a)", "var(--b)", "var(--c)")


def _scatter(left: int, names: Sequence[str], points: Matrix, reach: float) -> str:
    size, middle_x, middle_y = 130.0, left + 85.0, 85.0
    scale = 0.5 * size / reach
    dots = "".join(
        f'<circle cx="{middle_x + scale * a:.2f}" cy="{middle_y - scale * b:.2f}" r="2.2" '
        'fill="var(--a)" fill-opacity=".55"/>'
        for a, b in points.tolist()
    )
    box = (
        f'<rect x="{middle_x - size / 2}" y="{middle_y - size / 2}" width="{size}" height="{size}" '
        'fill="none" stroke="var(--line)"/>'
    )
    cross = (
        f'<path d="M{middle_x - 6},{middle_y}h12M{middle_x},{middle_y - 6}v12" '
        'stroke="var(--b)" stroke-width="1.5"/>'
    )
    label = (
        f'<text x="{middle_x}" y="{middle_y + size / 2 + 14}" text-anchor="middle">'
        f"{names[0]} →, {names[1]} ↑, ±{reach:g} mm</text>"
    )
    return box + cross + dots + label


def _line_plot(
    text: str,
    series: Sequence[tuple[str, Sequence[float], Sequence[float], str]],
    axes: tuple[str, str],
) -> str:
    top = _round_up(max(max(values) for _, _, values, _ in series) or 0.0)
    end = max(max(xs) for _, xs, _, _ in series) or 1.0
    width, height = _WIDTH - _LEFT - 10, _HEIGHT - _BOTTOM - 25
    parts: list[str] = []
    for k in range(5):
        y = 20 + height * (1.0 - k / 4)
        parts.append(
            f'<path d="M{_LEFT},{y:.1f}h{width}" stroke="var(--line)"/>'
            f'<text x="{_LEFT - 5}" y="{y + 4:.1f}" text-anchor="end">{top * k / 4:g}</text>'
        )
    parts.append(
        f'<text x="{_LEFT}" y="{_HEIGHT - 12}">0</text>'
        f'<text x="{_LEFT + width}" y="{_HEIGHT - 12}" text-anchor="end">{end:.3g} {axes[0]}</text>'
        f'<text x="4" y="12">{axes[1]}</text>'
    )
    for k, (name, xs, values, colour) in enumerate(series):
        points = " ".join(
            f"{_LEFT + width * x / end:.1f},{20 + height * (1.0 - value / top):.1f}"
            for x, value in zip(xs, values, strict=True)
        )
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.6"/>'
        )
        if len(series) > 1:
            parts.append(
                f'<text x="{_LEFT + 6 + 60 * k}" y="12" style="fill:{colour}">{name}</text>'
            )
    return _figure("".join(parts), text, _HEIGHT)


def _figure(parts: str, text: str, height: int) -> str:
    text = html.escape(text)
    return (
        f'<figure><svg viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="{text}">{parts}</svg>'
        f"<figcaption>{text}</figcaption></figure>"
    )


def _round_up(value: float) -> float:
    """Round up to 1, 2, 4, 5 or 10 times a power of ten."""
    value = max(value, 0.01)
    power = 10.0 ** math.floor(math.log10(value))
    return next(power * step for step in (1, 2, 4, 5, 10) if value <= power * step * (1 + 1e-9))


def _mm(metres: float | None) -> str:
    return "not known" if metres is None else f"{1000.0 * metres:.2f} mm"


def _duration(seconds: float) -> str:
    return f"{seconds / 60.0:.0f} min" if seconds >= 90.0 else f"{seconds:.0f} s"
