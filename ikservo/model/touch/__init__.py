"""Touch-off: the tip was put on points, and from that follows how this very arm differs.

Pure: joint vectors and points in, zero errors, link lengths, the base's pose and their worth out.
The estimate needs the chain, so it stands above kinematics, where it is said what an arm is.
"""

from ikservo.model.touch.estimate import Estimate, estimate
from ikservo.model.touch.fit import Fit
from ikservo.model.touch.layout import Extent, Layout, Parameter
from ikservo.model.touch.touches import Touch

__all__ = ["Estimate", "Extent", "Fit", "Layout", "Parameter", "Touch", "estimate"]
