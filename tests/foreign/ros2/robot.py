"""Genuine rclpy nodes that play a robot under ROS 2: Nav2, docking, drawer, gripper, battery, odometry, diagnostics.

Writes an event as a JSON line for each request that arrives. Options: --namespace NS, --lifecycle (the navigator is a
lifecycle node), --drive-s S (the duration of a drive), --clock (publishes /clock), --x and --y (the position at the start).
"""
import argparse, json, math, os, sys, threading, time
import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import QoSProfile, DurabilityPolicy
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from nav2_msgs.action import (
    BackUp, DockRobot, FollowWaypoints, NavigateThroughPoses, NavigateToPose, Spin, UndockRobot, Wait)
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger
from tf2_msgs.msg import TFMessage
try:
    from consort_test_msgs.msg import Gauge
except ImportError:
    Gauge = None

options = argparse.ArgumentParser()
options.add_argument("--namespace", default="")
options.add_argument("--lifecycle", action="store_true")
options.add_argument("--drive-s", type=float)
options.add_argument("--clock", action="store_true")
options.add_argument("--x", type=float, default=0.0)
options.add_argument("--y", type=float, default=0.0)
options = options.parse_args()


def event(what, **more):
    print(json.dumps({"event": what, **more}), flush=True)


class Robot:
    def __init__(self, node):
        self.node, self.group = node, ReentrantCallbackGroup()
        self.x, self.y, self.yaw, self.percentage, self.stopped, self.speed = options.x, options.y, 0.0, 0.83, False, 5.0
        self.state = "unconfigured" if options.lifecycle else "active"
        for name, kind, run in [("navigate_to_pose", NavigateToPose, self.navigate), ("spin", Spin, self.spin),
                                ("wait", Wait, self.wait), ("dock_robot", DockRobot, self.dock),
                                ("undock_robot", UndockRobot, self.undock), ("backup", BackUp, self.back_up),
                                ("navigate_through_poses", NavigateThroughPoses, self.through),
                                ("follow_waypoints", FollowWaypoints, self.follow)]:
            ActionServer(node, kind, name, self.recorded(name, run), callback_group=self.group,
                         cancel_callback=lambda goal, name=name: (event("cancel", action=name), CancelResponse.ACCEPT)[1])
        node.create_service(SetBool, "drawer", self.drawer, callback_group=self.group)
        node.create_service(Trigger, "grip", self.grip, callback_group=self.group)
        node.create_service(Trigger, "jam", lambda _, reply: self.refuse(reply), callback_group=self.group)
        node.create_subscription(String, "say", lambda message: event("said", text=message.data), 10)
        if options.lifecycle:
            node.create_service(GetState, f"{node.get_name()}/get_state", self.get_state, callback_group=self.group)
            node.create_service(ChangeState, f"{node.get_name()}/change_state", self.change_state, callback_group=self.group)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        publisher = node.create_publisher
        self.odom, self.amcl = publisher(Odometry, "odom", 10), publisher(PoseWithCovarianceStamped, "amcl_pose", latched)
        self.battery, self.diagnostics = publisher(BatteryState, "battery_state", 10), publisher(DiagnosticArray, "/diagnostics", 10)
        self.stop, self.tf = publisher(Bool, "emergency_stop", latched), publisher(TFMessage, "/tf", 10)
        self.tf_static = publisher(TFMessage, "/tf_static", latched)
        self.gauge = publisher(Gauge, "gauge", 10) if Gauge else None
        self.stop.publish(Bool(data=False))
        self.tf_static.publish(TFMessage(transforms=[self.transform("map", "odom", 1.0, 0.0)]))
        if options.clock:
            self.clock = publisher(Clock, "/clock", 10)
        node.create_timer(0.2, self.publish, callback_group=self.group)

    def recorded(self, name, run):
        def execute(goal):
            stamp = goal.request.pose.header.stamp.sec if name == "navigate_to_pose" else None
            event("goal", action=name, id=bytes(goal.goal_id.uuid).hex(), stamp=stamp)
            result = run(goal)
            event("ended", action=name, id=bytes(goal.goal_id.uuid).hex(), status=goal.status)
            return result
        return execute

    def work(self, goal, seconds, step=lambda share: None):
        """Returns true when the time has passed, false after a cancel."""
        begun = time.monotonic()
        while (passed := time.monotonic() - begun) < seconds:
            if goal.is_cancel_requested:
                goal.canceled()
                return False
            step(passed / seconds)
            time.sleep(0.05)
        return True

    def navigate(self, goal):
        to, (x, y) = goal.request.pose.pose, (self.x, self.y)
        if to.position.x > 1000:
            goal.abort()
            return NavigateToPose.Result(error_code=208, error_msg="no valid path")
        left = math.hypot(to.position.x - x, to.position.y - y)

        def step(share):
            self.x, self.y = x + share * (to.position.x - x), y + share * (to.position.y - y)
            feedback = NavigateToPose.Feedback(distance_remaining=left * (1 - share))
            feedback.current_pose.pose.position.x, feedback.current_pose.pose.position.y = self.x, self.y
            goal.publish_feedback(feedback)
        if not self.work(goal, options.drive_s or min(left / self.speed, 3.0) + 0.2, step):
            return NavigateToPose.Result()
        self.x, self.y = to.position.x, to.position.y
        self.yaw = 2 * math.atan2(to.orientation.z, to.orientation.w)
        self.publish()
        goal.succeed()
        return NavigateToPose.Result()

    def spin(self, goal):
        if self.work(goal, 0.5):
            self.yaw += goal.request.target_yaw
            goal.succeed()
        return Spin.Result()

    def wait(self, goal):
        time_s = goal.request.time.sec + goal.request.time.nanosec * 1e-9

        def step(share):
            left = time_s * (1 - share)
            goal.publish_feedback(Wait.Feedback(time_left=Duration(sec=int(left), nanosec=int(left % 1 * 1e9))))
        if self.work(goal, time_s, step):
            goal.succeed()
        return Wait.Result()

    def dock(self, goal):
        event("dock", dock=goal.request.dock_id, by_id=goal.request.use_dock_id)
        if goal.request.dock_id == "nowhere":
            goal.abort()
            return DockRobot.Result(success=False, error_code=901, error_msg="no such dock")
        if self.work(goal, 0.5):
            goal.succeed()
        return DockRobot.Result(success=True)

    def undock(self, goal):
        if self.work(goal, 0.5):
            goal.succeed()
        return UndockRobot.Result(success=True)

    def back_up(self, goal):
        event("backup", x=goal.request.target.x)
        if self.work(goal, 0.5):
            goal.succeed()
        return BackUp.Result()

    def through(self, goal):
        event("through", count=len(goal.request.poses))
        step = lambda share: goal.publish_feedback(NavigateThroughPoses.Feedback(distance_remaining=2.0 - share))
        if self.work(goal, 0.5, step):
            goal.succeed()
        return NavigateThroughPoses.Result()

    def follow(self, goal):
        event("waypoints", count=len(goal.request.poses))
        if self.work(goal, 0.5):
            goal.succeed()
        return FollowWaypoints.Result()

    def drawer(self, request, reply):
        event("drawer", open=request.data)
        reply.success, reply.message = True, "moved"
        return reply

    def grip(self, _, reply):
        event("grip")
        reply.success, reply.message = True, "holding"
        return reply

    def refuse(self, reply):
        reply.success, reply.message = False, "the gripper is jammed"
        return reply

    def get_state(self, _, reply):
        reply.current_state.label = self.state
        return reply

    def change_state(self, request, reply):
        self.state = {1: "inactive", 3: "active"}.get(request.transition.id, self.state)
        event("lifecycle", state=self.state)
        reply.success = True
        return reply

    def transform(self, parent, child, x, y):
        moved = TransformStamped(child_frame_id=child)
        moved.header.frame_id, moved.transform.rotation.w = parent, 1.0
        moved.transform.translation.x, moved.transform.translation.y = float(x), float(y)
        return moved

    def publish(self):
        odom, amcl = Odometry(child_frame_id="base_link"), PoseWithCovarianceStamped()
        for message in (odom, amcl):
            message.header.frame_id = "map"
            position, turn = message.pose.pose.position, message.pose.pose.orientation
            position.x, position.y, turn.z, turn.w = self.x, self.y, math.sin(self.yaw / 2), math.cos(self.yaw / 2)
        self.odom.publish(odom)
        self.amcl.publish(amcl)
        self.tf.publish(TFMessage(transforms=[self.transform("odom", "base_link", self.x, self.y)]))
        self.battery.publish(BatteryState(percentage=self.percentage, present=True))
        motor = DiagnosticStatus(name="motor", values=[KeyValue(key="temp", value="41.5")])
        self.diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(name="arm"), motor]))
        if self.gauge:
            self.gauge.publish(Gauge(litres=2.5, label="tank", history=[1.0, 2.0]))
        if options.clock:
            clock = Clock()
            clock.clock.sec = 4242
            self.clock.publish(clock)


rclpy.init()
node = rclpy.create_node("bt_navigator", namespace=options.namespace)
robot = Robot(node)
event("ready")
executor = MultiThreadedExecutor(num_threads=8)
executor.add_node(node)
threading.Thread(target=executor.spin, daemon=True).start()
sys.stdin.read()  # until the case ends
os._exit(0)
