"""What a touch-off says, for a person and as JSON: errors, what is known, what is not."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ikservo.model.touch import Estimate, Parameter
from ikservo.model.touch.conversation import Touching

__all__ = ["fields", "findings"]

_DETERMINED = 0.5  # of what was believed before: a parameter known twice as well


def findings(talk: Touching, found: Estimate) -> Iterator[str]:
    """Yield what the person should know before saving, one line each."""
    fit = found.fit
    yield (
        f"Cross-validated tip error: {_mm(found.before_m)} before, {_mm(found.after_m)} after "
        f"({len(talk.touches)} touches; estimated: {found.extent.value})."
    )
    for touch, good, residual_m in zip(talk.touches, fit.kept, fit.residuals_m, strict=True):
        if not good:
            yield f"Outlier, not used: {touch.point}, residual {_mm(float(residual_m))}."
    for parameter, value, deviation in _estimated(found):
        if deviation < _DETERMINED * parameter.prior:
            yield f"{parameter.name}: {_say(value, parameter)} ± {_say(deviation, parameter)}"
    unknown = [p.name for p, _, d in _estimated(found) if d >= _DETERMINED * p.prior]
    if unknown:
        yield f"Not identified by these touches: {', '.join(unknown)}."
    told = int(np.count_nonzero(fit.scaled > 1.0))
    yield f"Parameters identified: {told} of {len(fit.scaled)}."
    middle_m, most_m = found.deviation_m
    yield (
        f"Expected tip error (1 sigma) in the workspace: median {_mm(middle_m)}, "
        f"95 % below {_mm(most_m)}."
    )


def fields(talk: Touching, found: Estimate) -> dict[str, object]:
    """Return the same for ``--json``; metres and radians."""
    fit = found.fit
    rows = zip(talk.touches, fit.kept.tolist(), fit.residuals_m.tolist(), strict=True)
    return {
        "changed": found.extent.value,
        "before_m": found.before_m,
        "after_m": found.after_m,
        "expected_m": found.deviation_m[0],
        "expected_worst_m": found.deviation_m[1],
        "touches": [
            {"point": touch.point, "used": used, "residual_m": residual_m}
            for touch, used, residual_m in rows
        ],
        "parameters": [
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "value": value,
                "deviation": deviation,
                "deviation_before": parameter.prior,
                "determined": deviation < _DETERMINED * parameter.prior,
            }
            for parameter, value, deviation in _estimated(found)
        ],
        "singular_values": fit.scaled,
    }


def _estimated(found: Estimate) -> list[tuple[Parameter, float, float]]:
    """Return each number that was estimated, with its value and standard deviation."""
    fit = found.fit
    deviations = np.sqrt(np.diag(fit.covariance))
    rows = zip(fit.layout.parameters, fit.values.tolist(), deviations.tolist(), strict=True)
    return [row for row in rows if row[0].free]


def _say(value: float, parameter: Parameter) -> str:
    if parameter.unit == "m":
        return _mm(value)
    return f"{math.degrees(value):.2f}°"


def _mm(metres: float) -> str:
    return f"{1000 * metres:.1f} mm"
