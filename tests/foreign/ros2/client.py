"""A genuine client of a simulated robot: one drive by NavigateToPose, and what the robot publishes meanwhile."""
import json, os, rclpy
from rclpy.action import ActionClient
from nav_msgs.msg import Odometry
from nav2_msgs.action import NavigateToPose
from sensor_msgs.msg import BatteryState
from tf2_msgs.msg import TFMessage

rclpy.init()
node = rclpy.create_node("client")
topics = set()
node.create_subscription(Odometry, "/ada/odom", lambda message: topics.add("odom"), 10)
node.create_subscription(BatteryState, "/ada/battery_state", lambda message: message.percentage > 0.5 and topics.add("battery_state"), 10)
node.create_subscription(TFMessage, "/tf", lambda message: message.transforms[0].child_frame_id == "ada/base_link" and topics.add("tf"), 10)
client = ActionClient(node, NavigateToPose, "/ada/navigate_to_pose")
client.wait_for_server(30)


def wait(future):
    rclpy.spin_until_future_complete(node, future, timeout_sec=60)
    return future.result()


goal = NavigateToPose.Goal()
goal.pose.header.frame_id = "map"
goal.pose.pose.position.x, goal.pose.pose.position.y = 13.5, 11.0
result = wait(wait(client.send_goal_async(goal)).get_result_async())
for _ in range(50):
    if len(topics) == 3:
        break
    rclpy.spin_once(node, timeout_sec=0.2)
print(json.dumps({"event": "result", "status": result.status, "error": result.result.error_msg, "topics": sorted(topics)}), flush=True)
os._exit(0)
