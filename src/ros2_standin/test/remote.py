"""Two nodes to look at: /remote, managed, with parameters; and /axis/listener."""

import rclpy
from rcl_interfaces.msg import (
    FloatingPointRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header, String

rclpy.init()
node = LifecycleNode("remote")
listener = rclpy.create_node("listener", namespace="/axis")

gain = ParameterDescriptor(
    description="Gain (V/A)",
    floating_point_range=[FloatingPointRange(from_value=0.0, to_value=10.0)],
)
node.declare_parameter("gain", 1.5, gain)
node.declare_parameter("mode", "fast")
node.declare_parameter("number", 7, ParameterDescriptor(read_only=True))
node.declare_parameter("filter.poles", [1.0, 2.0])
node.declare_parameter("filter.names", ["a", "b"])


def check(parameters):
    """Refuse one value."""
    bad = any(p.name == "mode" and p.value == "bad" for p in parameters)
    return SetParametersResult(successful=not bad, reason="'bad' is no mode" if bad else "")


node.add_on_set_parameters_callback(check)
ticks = node.create_publisher(Header, "ticks", 1000)
latched = node.create_publisher(
    String, "latched", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
)
latched.publish(String(data="stays"))
hidden = node.create_publisher(String, "_hidden", 10)
listener.create_subscription(String, "/latched", lambda message: None, 10)

count = 0


def tick():
    """Publish the next number."""
    global count
    ticks.publish(Header(frame_id=str(count)))
    count += 1


node.create_timer(0.01, tick)
executor = SingleThreadedExecutor()
executor.add_node(node)
executor.add_node(listener)
print("ready", flush=True)
executor.spin()
