"""Foreign descriptions of arms, converted once: what `ikservo arms new` writes, `model` reads."""

from ikservo.app import App

APP = App(name="importing")
