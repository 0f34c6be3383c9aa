"""Describe arms: their files, the catalogue, and the model built from them."""

from ikservo.model.arm_model import Model, ModelJoint, ModelServo, SpeedClass
from ikservo.model.catalogue import arm_names, find_arm
from ikservo.model.model_loading import load_model

__all__ = ["Model", "ModelJoint", "ModelServo", "SpeedClass", "arm_names", "find_arm", "load_model"]
