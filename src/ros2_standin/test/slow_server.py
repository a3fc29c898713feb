"""A service that is asked and does not answer; SIGTERM ends it in order."""

import signal
import sys
import threading

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node("slow_server")


def answer(request, response):
    """Take for ever."""
    print("asked", flush=True)
    threading.Event().wait()
    return response


def leave(number, frame):
    """Leave the graph, as who ends in order does."""
    node.destroy_node()
    rclpy.try_shutdown()
    sys.exit()


signal.signal(signal.SIGTERM, leave)
node.create_service(Trigger, "slow", answer)
executor = SingleThreadedExecutor()
executor.add_node(node)
print("ready", flush=True)
executor.spin()
