# SPDX-License-Identifier: Apache-2.0
"""Takes managed nodes up in an order, looks after them, and takes them down again: a lifecycle manager.

    ros2 launch machine_tool_calibration graph.launch.py autostart:=false
    python examples/lifecycle_manager.py recorder axis_simulator rotary_pointer instrument estimator procedure

A node that was started anew is unconfigured: it is taken up again. Ctrl-C deactivates them and cleans them up, the last
one first; with --shutdown it ends their processes, too. In a namespace: --ros-args -r __ns:=/NAMESPACE.
"""

import argparse
import signal
import sys
from typing import Any

import rclpy
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.client import Client
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

UP = {
    State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_CONFIGURE,
    State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_ACTIVATE,
}
DOWN = {
    State.PRIMARY_STATE_ACTIVE: Transition.TRANSITION_DEACTIVATE,
    State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_CLEANUP,
}
END = {State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_UNCONFIGURED_SHUTDOWN}


class Manager:
    """Asks managed nodes for their states, and for transitions."""

    def __init__(self, names: list[str]) -> None:
        self.node = rclpy.create_node("lifecycle_manager")
        self.names = names
        self.states = {name: self.node.create_client(GetState, f"{name}/get_state") for name in names}
        self.changes = {name: self.node.create_client(ChangeState, f"{name}/change_state") for name in names}

    def ask(self, client: Client, request: Any) -> Any:
        """The answer; None where there is none."""
        if not client.wait_for_service(timeout_sec=5.0):
            return None
        asked = client.call_async(request)
        rclpy.spin_until_future_complete(self.node, asked, timeout_sec=30.0)
        return asked.result()

    def bring(self, name: str, ways: dict[int, int]) -> bool:
        """Make transitions until none is left to be made; False where one cannot be made."""
        while True:
            found = self.ask(self.states[name], GetState.Request())
            if found is None or found.current_state.id not in ways:
                return found is not None
            request = ChangeState.Request(transition=Transition(id=ways[found.current_state.id]))
            changed = self.ask(self.changes[name], request)
            print(
                f"{name}: {found.current_state.label} -> {'done' if changed and changed.success else 'FAILED'}",
                flush=True,
            )
            if changed is None or not changed.success:
                return False
            if request.transition.id == Transition.TRANSITION_UNCONFIGURED_SHUTDOWN:
                return True  # its process ends


def main() -> None:
    """Take the nodes up that are named on the command line, and look after them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="+", metavar="NODE", help="in the order in which they are taken up")
    parser.add_argument("--shutdown", action="store_true", help="end their processes at the end, too")
    options = parser.parse_args(remove_ros_args(sys.argv)[1:])
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True

    # Ctrl-C is this program's own. A KeyboardInterrupt would be lost where it comes within the destructor of a Future:
    # Python only prints "Exception ignored in ...".
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGINT, stop)
    manager = Manager(options.names)
    while not stopped:
        if not all([stopped or manager.bring(name, UP) for name in manager.names]):
            raise SystemExit("a node cannot be taken up")
        rclpy.spin_once(manager.node, timeout_sec=0.2)
    for name in reversed(manager.names):
        manager.bring(name, {**DOWN, **(END if options.shutdown else {})})


if __name__ == "__main__":
    main()
