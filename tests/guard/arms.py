"""The arms of these tests, loaded once: models and bodies do not change."""

from functools import cache

from ikservo.model import load_model
from ikservo.model.shell import body_of


@cache
def model_of(name):
    return load_model(name)


@cache
def body(name):
    return body_of(model_of(name))
