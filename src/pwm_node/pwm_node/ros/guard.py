"""What must not end a drive: an exception in a service, or in a callback off the loop.

rclpy raises out of its own services what it cannot make sense of (a transition that is not possible
now, a parameter type that does not exist), and an executor passes that on. Here such a request is
refused, and said so in the log; the loop goes on.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.impl.implementation_singleton import rclpy_implementation

from pwm_node.errors import ForPeople

Service = Callable[[Any, Any], Any]

# Of the same complaint, one line in this time (s).
_SAY_EVERY = 1.0

_TOO_LATE = (
    "not set, since this request has waited for too long: more is asked of this node than it can "
    "serve beside its loop; ask less often, or set several parameters by one request"
)


def service(callback: Service, kind: Any, name: str, logger: Any) -> Service:
    """Return a service's callback that refuses what the given one raises at.

    Parameters
    ----------
    callback : callable
        Takes request and response, and returns the response.
    kind : type
        Type of the service. A response that has a `success` or a `result` says that it was refused,
        and why where it has room for that; any other one stays empty.
    name : str
        Name of the service, for the log.
    logger : RcutilsLogger
        Where the exception is told.
    """

    @functools.wraps(callback)
    def answer(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:  # noqa: BLE001 (whatever it is, it must not end the drive)
            reason = describe(error)
            _tell(logger, f"{name}: request refused: {reason}")
            return _refusal(kind, reason)

    if kind is not SetParameters:
        return answer

    @functools.wraps(callback)
    def answer_one_by_one(request: Any, response: Any) -> Any:
        # One that cannot be is no reason not to answer the others.
        for parameter in request.parameters:
            alone = answer(SetParameters.Request(parameters=[parameter]), SetParameters.Response())
            response.results.extend(alone.results)
        return response

    return answer_one_by_one


def in_time(callback: Service, kind: Any, *, late: Callable[[], bool]) -> Service:
    """Return a service's callback that sets no parameters for a request that has waited too long.

    To refuse takes a fraction of what it takes to serve, so that the queue gets shorter. What else
    a service is asked for is done however late: a stop above all.

    Parameters
    ----------
    callback : callable
        Takes request and response, and returns the response.
    kind : type
        Type of the service.
    late : callable
        Tells whether the request that is served now has waited for too long.
    """
    if kind is not SetParameters and kind is not SetParametersAtomically:
        return callback

    @functools.wraps(callback)
    def answer(request: Any, response: Any) -> Any:
        if not late():
            return callback(request, response)
        response = _refusal(kind, _TOO_LATE)
        if kind is SetParameters:
            response.results *= len(request.parameters)
        return response

    return answer


def callback(callback: Callable[..., None], what: str, logger: Any) -> Callable[..., None]:
    """Return a callback that says in the log what the given one raises, as `what: ...`."""

    # wrapped, it still has the arguments by which rclpy knows whether it wants a message's info
    @functools.wraps(callback)
    def call(*arguments: Any) -> None:
        try:
            callback(*arguments)
        except Exception as error:  # noqa: BLE001 (whatever it is, it must not end the drive)
            _tell(logger, f"{what}: {describe(error)}")

    return call


def _tell(logger: Any, text: str) -> None:
    logger.error(text, throttle_duration_sec=_SAY_EVERY)


def _refusal(kind: Any, reason: str) -> Any:
    """An answer that says no."""
    response = kind.Response()
    no = SetParametersResult(successful=False, reason=reason)
    if kind is SetParameters:
        response.results = [no]
    elif kind is SetParametersAtomically:
        response.result = no
    elif hasattr(response, "success"):
        response.success = False
        if hasattr(response, "message"):
            response.message = reason
    return response


def describe(error: BaseException) -> str:
    """Return an error as one line: our own say all, of others the place is named too."""
    text = " ".join((str(error) or type(error).__name__).split())
    if isinstance(error, rclpy_implementation.RCLError):
        return text.split(", at /")[0]  # what follows are places in C sources
    if isinstance(error, ForPeople) or (
        isinstance(error, ValueError) and type(error) is not ValueError
    ):
        return text
    place = ""
    trace = error.__traceback__
    while trace is not None:
        place = f" ({trace.tb_frame.f_code.co_filename}:{trace.tb_lineno})"
        trace = trace.tb_next
    return f"{type(error).__name__}: {text}{place}"
