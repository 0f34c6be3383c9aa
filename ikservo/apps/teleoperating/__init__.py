"""Move the tool by a hand, a phone or a tracker, as if the hand held the gripper."""

from ikservo.app import App

APP = App(
    name="teleoperating",
    names={"TrackedPose": "ikservo.apps.teleoperating.pose_filter:TrackedPose"},
    arm_methods={"follow_pose": "ikservo.apps.teleoperating.pose_following:follow_pose"},
    parts={
        "pose filter": "ikservo.apps.teleoperating.pose_filter:PoseFilter",
        "tracked pose": "ikservo.apps.teleoperating.pose_filter:TrackedPose",
    },
)
