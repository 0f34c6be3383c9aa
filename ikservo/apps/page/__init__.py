"""The browser panel: drag a link or click a target, and the arm follows."""

from ikservo.app import App, Command

APP = App(
    name="page",
    names={"visible_from": "ikservo.apps.page.picking.visibility:visible_from"},
    commands={
        "view": Command(
            "ikservo.apps.page.view_command",
            "Open the browser panel: drag the arm with the mouse.",
            "Move",
        ),
    },
    parts={
        "where --visible-from": "ikservo.apps.page.picking.visibility:visible_from",
        "certificate": "ikservo.apps.page.server.certificate:load_or_make_certificate",
    },
)
