"""Models and collision bodies of the arms, loaded once."""

from functools import cache

from ikservo.model import load_model
from ikservo.model.collision_capsules import collision_body


@cache
def model_of(name):
    return load_model(name)


@cache
def body(name):
    return collision_body(model_of(name))
