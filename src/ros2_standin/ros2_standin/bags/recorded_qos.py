"""Quality of service: what a recorder asks for, what is written to a bag, what a player offers."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.duration import Duration
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

_SECOND = 10**9  # ns
#: Depth to play with where the recorded one is not known: that of ROS 2's default profile.
_DEPTH = 10


def request_for(offers: Sequence[QoSProfile]) -> QoSProfile:
    """
    Return the profile to record a topic with: the strictest that all its publishers offer.

    All messages are kept until they are written. A publisher that keeps all, too, is slowed down by
    a recorder that cannot follow, rather than recorded with gaps.
    """
    reliable = all(o.reliability == QoSReliabilityPolicy.RELIABLE for o in offers)
    latched = all(o.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for o in offers)
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_ALL,
        reliability=(
            QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            QoSDurabilityPolicy.TRANSIENT_LOCAL
            if latched and offers
            else QoSDurabilityPolicy.VOLATILE
        ),
    )


def offer_of(recorded: Sequence[Qos]) -> QoSProfile | None:
    """
    Return the profile to play a topic with: the recorded one.

    Returns
    -------
    QoSProfile or None
        None if the recorded publishers differed.
    """
    profiles = [from_bag(qos) for qos in recorded]
    if not profiles:
        return QoSProfile(depth=10)
    policies = {(p.reliability, p.durability, p.liveliness) for p in profiles}
    return profiles[0] if len(policies) == 1 else None


def to_bag(profile: QoSProfile) -> Qos:
    """Return a profile as it is written to a bag. The numbers of the policies are the same."""
    return Qos(
        history=QosHistory(int(profile.history)),
        depth=profile.depth,
        reliability=QosReliability(int(profile.reliability)),
        durability=QosDurability(int(profile.durability)),
        deadline=_time(profile.deadline),
        lifespan=_time(profile.lifespan),
        liveliness=QosLiveliness(int(profile.liveliness)),
        liveliness_lease_duration=_time(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def from_bag(qos: Qos) -> QoSProfile:
    """Return a profile that was read from a bag."""
    latched = qos.durability == QosDurability.TRANSIENT_LOCAL
    profile = QoSProfile(depth=qos.depth or _DEPTH)
    # History and depth of a publisher cannot be seen over the network, so most bags do not know
    # them. Then all is kept until everybody has it, but for those who come late: a depth suffices.
    unknown = qos.history != QosHistory.KEEP_LAST and not latched
    if qos.history == QosHistory.KEEP_ALL or unknown:
        profile.history = QoSHistoryPolicy.KEEP_ALL
    if qos.reliability == QosReliability.BEST_EFFORT:
        profile.reliability = QoSReliabilityPolicy.BEST_EFFORT
    if latched:
        profile.durability = QoSDurabilityPolicy.TRANSIENT_LOCAL
    if qos.liveliness == QosLiveliness.MANUAL_BY_TOPIC:
        profile.liveliness = QoSLivelinessPolicy.MANUAL_BY_TOPIC
    profile.deadline = _duration(qos.deadline)
    profile.lifespan = _duration(qos.lifespan)
    profile.liveliness_lease_duration = _duration(qos.liveliness_lease_duration)
    return profile


def _time(duration: Duration) -> QosTime:
    return QosTime(*divmod(duration.nanoseconds, _SECOND))


def _duration(time: QosTime) -> Duration:
    # Forever is written as 9223372036.854775807 s, or as more than fits by older versions.
    return Duration(nanoseconds=min(time.sec * _SECOND + time.nsec, 2**63 - 1))
