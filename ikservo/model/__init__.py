"""Description of an arm: its files, the catalogue of arms, and the model built from them."""

from ikservo.model.catalogue import arm_names, find_arm
from ikservo.model.loading import load_model
from ikservo.model.model import Model, ModelJoint, ModelServo, SpeedClass

__all__ = ["Model", "ModelJoint", "ModelServo", "SpeedClass", "arm_names", "find_arm", "load_model"]
