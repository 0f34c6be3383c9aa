"""Tab order of a part of the page, compared with its reading order."""

import itertools

# What Tab reaches inside an element, each with its box; the first one gets the focus.
REACHABLE = """(root) => [...document.querySelector(root).querySelectorAll(
  "a, button, input, select, summary")]
  .filter((e) => e.checkVisibility() && !e.disabled && e.tabIndex >= 0)
  .map((e, i) => {
    if (i === 0) e.focus();
    const { left, right, top, bottom } = e.getBoundingClientRect();
    return { left, right, top, bottom, name: e.id || e.ariaLabel || e.textContent };
  })"""
FOCUSED = "() => { const e = document.activeElement; return e.id || e.ariaLabel || e.textContent; }"


def comes_before(box, other):
    """Return whether a box is read before another one: above it, or in its row to the left."""
    same_row = box["top"] < other["bottom"] and other["top"] < box["bottom"]
    return box["left"] < other["left"] if same_row else box["top"] < other["top"]


def expect_read_in_order(page, root):
    """Expect that Tab goes through an element row by row, each from left to right."""
    boxes = page.evaluate(REACHABLE, root)
    reached = [page.evaluate(FOCUSED)]
    for _ in boxes[1:]:
        page.keyboard.press("Tab")
        reached.append(page.evaluate(FOCUSED))
    assert reached == [box["name"] for box in boxes]
    early = [(a["name"], b["name"]) for a, b in itertools.pairwise(boxes) if not comes_before(a, b)]
    assert early == []
