"""The cases of run.sh. `--list` prints their names; arguments select."""
import json, os, pathlib, re, signal, sys, time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[2]
sys.path.insert(0, str(HERE.parent / "common"))
from processes import free_port, wait_for
from suite import Suite, check
from world import CONSORT, LIMIT, ROS2, V, Process, World, is_event

SUITE = Suite("ros2", prefix="ros2_")
case = SUITE.case


ROBOT = """
extends: [turtlebot, nav2_moves]
pose: { topic: odom, type: nav_msgs/msg/Odometry }
readings:
  motor_c: { topic: /diagnostics, type: diagnostic_msgs/msg/DiagnosticArray, field: "status[name=motor].values[key=temp].value", as: number }
  tank_l: { topic: gauge, type: consort_test_msgs/msg/Gauge, field: litres }
actions:
  operate_drawer: { service: drawer, type: std_srvs/srv/SetBool, send: { data: "${action == open}" }, succeeded: success, results: { note: message } }
  pick_up: { service: grip, type: std_srvs/srv/Trigger, succeeded: success }
  jam: { service: jam, type: std_srvs/srv/Trigger, succeeded: success }
  say: { topic: say, type: std_msgs/msg/String, send: { data: "${robot}: ${text}" } }
  approach_person: { topic: say, type: std_msgs/msg/String, send: { data: "good day, ${role}" } }
  authenticate_person: { topic: say, type: std_msgs/msg/String, send: { data: "badge, ${role}" } }
  approach_robot: { topic: say, type: std_msgs/msg/String, send: { data: "approaching ${robot}" } }
  release: { topic: say, type: std_msgs/msg/String, send: { data: "release" }, until: { topic: emergency_stop, type: std_msgs/msg/Bool, field: data, equals: false } }
"""


def pose(x, y):
    return {"x_m": x, "y_m": y, "yaw_rad": 0.0}


@case
def nav2_docking_and_services(world):
    """Every kind of mapping: actions of Nav2, DockRobot, services, topics; results, failures and causes."""
    robot, driver = world.robot(), world.driver(world.file("robot.yaml", ROBOT))
    check(driver.do(1, "navigate_to_pose", pose=pose(3.0, 2.0))["status"] == "succeeded", "the drive fails")
    feedback = [sent for sent in driver.seen if sent["type"] == "feedback"]
    check(feedback and 0 < feedback[0]["distance_remaining_m"] < 4, f"feedback: {feedback[:1]}")
    failed = driver.do(2, "navigate_to_pose", pose=pose(2000.0, 0.0))
    check((failed["status"], failed["code"], failed["message"]) == ("aborted", "no_route", "no valid path (error 208)"), f"{failed}")
    check(driver.do(3, "dock", charger="Dock")["status"] == "succeeded", "the dock fails")
    robot.message("the dock's id", is_event("dock", dock="Dock", by_id=True))
    check(driver.do(4, "dock", charger="nowhere")["code"] == "charger", "a dock that does not exist")
    check(driver.do(5, "spin", angle_rad=1.0)["status"] == "succeeded", "the spin fails")
    check(driver.do(6, "wait", time=0.3)["status"] == "succeeded", "the wait fails")
    points = [{"pose": pose(1.0, 0.0), "place": None}, {"pose": pose(2.0, 0.0)}]
    check(driver.do(7, "follow_waypoints", waypoints=points)["status"] == "succeeded", "the waypoints fail")
    robot.message("two waypoints", is_event("waypoints", count=2))
    opened = driver.do(8, "operate_drawer", action="open")
    check(opened["status"] == "succeeded" and opened["results"] == {"note": "moved"}, f"{opened}")
    robot.message("the drawer opens", is_event("drawer", open=True))
    jammed = driver.do(9, "jam")
    check((jammed["status"], jammed["message"]) == ("aborted", "the gripper is jammed"), f"{jammed}")
    check(driver.do(10, "say", text="hello")["status"] == "succeeded", "the topic fails")
    robot.message("the text", is_event("said", text="ada: hello"))
    check(driver.do(11, "release")["status"] == "succeeded", "`until` is not reached")
    check(driver.do(12, "fly")["code"] == "unknown", "an action that is not described")
    check(driver.do(13, "undock")["status"] == "succeeded", "the undock fails")
    check(driver.do(14, "navigate_through_poses", waypoints=points)["status"] == "succeeded", "the drive through poses fails")
    robot.message("two poses", is_event("through", count=2))
    check(driver.do(15, "back_up", distance_m=0.5)["status"] == "succeeded", "the drive backwards fails")
    robot.message("half a metre", is_event("backup", x=0.5))


@case
def pose_charge_and_readings(world):
    """Odometry, BatteryState, diagnostics, a latched stop, and a message that only its node describes."""
    world.robot("--x", "4.0", "--y", "5.0")
    driver = world.driver(world.file("robot.yaml", ROBOT))
    driver.message("the pose", lambda sent: sent["type"] == "pose" and (sent["x_m"], sent["y_m"]) == (4.0, 5.0))
    driver.message("the charge", lambda sent: sent["type"] == "charge" and sent["share"] == 0.83)
    wanted, found = {"emergency_stop": False, "motor_c": 41.5, "tank_l": 2.5}, {}
    while found != wanted:
        sent = [message for message in driver.seen if message["type"] == "readings"]
        for message in sent:
            found.update(message["values"])
        if found != wanted:
            driver.message(f"the readings {wanted}, not {found}", lambda sent: sent["type"] == "readings")


@case
def pose_by_transforms(world):
    """map → odom is latched on /tf_static, odom → base_link arrives on /tf."""
    world.robot("--x", "2.0")
    driver = world.driver(world.file("robot.yaml", "extends: [nav2]\npose: { tf: base_link }\n"))
    driver.message("the pose", lambda sent: sent["type"] == "pose" and abs(sent["x_m"] - 3.0) < 1e-6)


@case
def cancel_and_permission(world):
    """A cancel and the end of the permission stop the robot."""
    robot = world.robot("--drive-s", "60")
    driver = world.driver(world.file("robot.yaml", ROBOT))
    driver.goal(1, "navigate_to_pose", pose=pose(9.0, 0.0))
    robot.message("the goal", is_event("goal", action="navigate_to_pose"))
    driver.send("cancel", id="1")
    check(driver.result(1)["status"] == "canceled", "the goal is not canceled")
    driver.goal(2, "navigate_to_pose", keep_for_ms=900, pose=pose(9.0, 0.0))
    check(driver.result(2)["status"] == "canceled", "the permission has no end")
    robot.message("the second cancel", is_event("ended", status=5))


@case
def sigterm_cancels_goals(world):
    """SIGTERM cancels the goal in Nav2, and the driver ends with 0."""
    robot = world.robot("--drive-s", "60")
    driver = world.driver(world.file("robot.yaml", ROBOT))
    driver.goal(1, "navigate_to_pose", pose=pose(9.0, 0.0))
    robot.message("the goal", is_event("goal", action="navigate_to_pose"))
    check(driver.stop() == 0, "the driver ends with a failure")
    robot.message("the goal is canceled", is_event("ended", status=5))


@case
def a_restart_resumes_or_cancels(world):
    """After SIGKILL the next process continues a resumed goal by its id, and cancels one that is not resumed."""
    robot, file = world.robot("--drive-s", "60"), world.file("robot.yaml", ROBOT)
    first = world.driver(file)
    first.goal(7, "navigate_to_pose", pose=pose(9.0, 0.0))
    begun = robot.message("the goal", is_event("goal", action="navigate_to_pose"))
    first.stop(signal.SIGKILL)
    second = world.driver(file)
    second.goal(7, "navigate_to_pose", resumed=True, pose=pose(9.0, 0.0))
    second.message("feedback of the resumed goal", lambda sent: sent["type"] == "feedback" and sent["id"] == "7")
    check(not any(is_event("goal")(event) for event in robot.seen[robot.seen.index(begun) + 1:]), "the goal was sent twice")
    second.stop(signal.SIGKILL)
    third = world.driver(file)
    robot.message("the goal of the previous process is canceled", is_event("ended", id=begun["id"], status=5))
    check(third.do(8, "wait", time=0.2)["status"] == "succeeded", "the next goal fails")


@case
def namespace_clock_and_lifecycle(world):
    """A robot in a namespace, with simulated time, whose navigator must be activated."""
    robot = world.robot("--namespace", "/ada", "--clock", "--lifecycle")
    text = ROBOT + "namespace: ada\nuse_sim_time: true\nlifecycle: { nodes: [bt_navigator], activate: %s }\n"
    strict = world.driver(world.file("strict.yaml", text % "false"))
    refused = strict.do(1, "navigate_to_pose", pose=pose(1.0, 0.0))
    check("the lifecycle node /ada/bt_navigator is unconfigured" in refused.get("message", ""), f"{refused}")
    strict.stop()
    driver = world.driver(world.file("robot.yaml", text % "true"))
    driver.message("the charge", lambda sent: sent["type"] == "charge" and sent["share"] == 0.83)
    check(driver.do(1, "navigate_to_pose", pose=pose(1.0, 0.0))["status"] == "succeeded", "the drive fails")
    goal = robot.message("the goal", is_event("goal", action="navigate_to_pose"))
    check(goal["stamp"] == 4242, f"the stamp is {goal['stamp']}")
    states = [event["state"] for event in robot.seen if event["event"] == "lifecycle"]
    check(states == ["inactive", "active"], f"{states}")


@case
def open_rmf_doors_and_lifts(world):
    """The shipped mappings: a door opens and closes, a lift comes to the floor of a place; another session, a fire, a restart."""
    building = world.robot("--door", "ward-door", "--door", "other", "--lift", "lift-a=L1,L2", script="building.py")
    door = world.driver("rmf_door", "ward-door")
    door.goal(1, "serve")
    opened = building.message("the door opens", is_event("door", name="ward-door", mode=2, requester="consort"))
    check(abs(opened["stamp"] - time.time()) < 60, f"the stamp is {opened['stamp']}")
    door.ready(1, True)
    door.send("cancel", id="1")
    building.message("the door closes", is_event("door", name="ward-door", mode=0))
    check(door.result(1)["status"] == "canceled", "the goal is not canceled")
    door.goal(2, "alarm", position="closed")
    door.ready(2, True)
    door.send("cancel", id="2")
    check(door.result(2)["status"] == "canceled", "the alarm is not canceled")
    door.goal(3, "serve")
    door.ready(3, True)
    door.stop(signal.SIGKILL)
    world.driver("rmf_door", "ward-door")
    building.message("the next process closes the door", is_event("door", name="ward-door", mode=0))

    lift = world.driver(world.file("lift.yaml", "extends: [rmf_lift]\ntables: { floor: { Ground: L1, First: L2 } }\n"), "lift-a")
    lift.goal(1, "serve", place="First")
    building.message("the lift comes", is_event("lift", floor="L2", session="consort/lift-a"))
    lift.ready(1, True)
    building.child.stdin.write("mode 3\n")
    building.child.stdin.flush()
    lift.ready(1, False)
    lift.send("cancel", id="1")
    building.message("the session ends", is_event("lift_ends", session="consort/lift-a"))
    check(lift.result(1)["status"] == "canceled", "the goal is not canceled")


@case
def conformance(world):
    """The driver fulfils the protocol (`consort driver check`), with a goal that takes 2 s."""
    world.robot()
    file = world.file("robot.yaml", "extends: [nav2]\nactions:\n  wait: { action: wait, type: nav2_msgs/action/Wait, send: { time: '${time}' }, "
                      "feedback: { time_remaining_s: time_left }, example: { time: 2.0 } }\n")
    ran = world.run(CONSORT, "driver", "check", "--", ROS2, "driver", file, limit=400)
    failed = [line for line in ran.stdout.splitlines() if line.startswith("FAILED")]
    check(ran.returncode == 0, f"{failed or ran.stderr[-300:]}")


@case
def hashes_of_released_messages(world):
    """The shipped definitions have the hashes that the wheels of Jazzy and Kilted were released with."""
    shipped = dict(line.split() for line in world.run(ROS2, "types").stdout.splitlines())
    for release, environment in (("Jazzy", V), ("Kilted", os.environ["KILTED"])):
        compared = set()
        for file in pathlib.Path(environment, "share").glob("*/*/*.json"):
            for released in json.loads(file.read_text(encoding="utf-8")).get("type_hashes", []):
                name, hash = released["type_name"], released["hash_string"]
                check(shipped.get(name, hash) == hash, f"{name} of {release} is {hash}, and shipped is {shipped.get(name)}")
                compared.update({name} & shipped.keys())
        check(len(compared) >= 60, f"{release}: {len(compared)} types were compared")


@case
def doctor(world):
    """Fits, a missing server, a lifecycle node and a wrong type are told apart; all hashes of genuine nodes are known."""
    world.robot("--namespace", "/ada")
    good = world.file("good.yaml", ROBOT + "namespace: ada\n")
    ran = world.run(ROS2, "doctor", good, "--wait", "30")
    lines = ran.stdout.splitlines()
    for part in ("actions.navigate_to_pose: /ada/navigate_to_pose/_action/send_goal nav2_msgs/action/NavigateToPose_SendGoal RIHS01_",
                 "actions.dock: /ada/dock_robot", "gauge consort_test_msgs/msg/Gauge RIHS01_", "/ada/bt_navigator"):
        check(any(line.startswith("ok") and part in line for line in lines), f"no {part!r} in {ran.stdout}")
    missing = [line for line in lines if line.startswith("PROBLEM")]
    check(ran.returncode == 0 and not missing, f"{missing}")
    wrong = world.file("wrong.yaml", "readings: { stop: { topic: /ada/odom, type: std_msgs/msg/Bool, field: data } }\n"
                       "actions:\n  spin: { action: spin, type: nav2_msgs/action/Spin, send: {} }\n")
    parts = ("no server of /spin/_action/send_goal; the graph has /ada/spin/_action/send_goal",
             "/ada/odom has the type nav_msgs/msg/Odometry; expected std_msgs/msg/Bool")

    def found():
        ran = world.run(ROS2, "doctor", wrong, "--wait", "2")
        return ran.returncode == 1 and all(part in ran.stdout for part in parts)
    wait_for(f"the findings {parts}", found, LIMIT)


@case
def simulated_robots_for_ros_2(world):
    """A simulated robot drives by a genuine action client, and publishes odometry, transform and battery; a second bridge is refused."""
    port = free_port()
    world.file("world.toml", f'name = "world"\nspeed = 10.0\n[fleet]\nname = "sim"\nmap = "hospital"\n[bus]\nlisten = ["tcp/127.0.0.1:{port}"]\n'
               '[[robot]]\nid = "ada"\nplace = "Dock"\nspeed_mps = 0.6\nbattery = 0.9\ndischarge_share_per_s = 0.0001\n')
    Process(world, [CONSORT, "world", "--config", "world.toml"])
    serve = [ROS2, "serve", "--fleet", "sim", "--map", "hospital", "--connect", f"tcp/127.0.0.1:{port}", "--router", f"tcp/127.0.0.1:{world.port}"]
    Process(world, serve)
    client = world.ros("client.py")
    seen = client.message("the end of the drive", lambda event: event["event"] == "result")
    check(seen["status"] == 4 and set(seen["topics"]) == {"odom", "tf", "battery_state"}, f"{seen}")
    second = world.run(*serve)
    check(second.returncode == 1 and "another `consort-ros2 serve` offers the fleet sim" in second.stderr, f"{second.stderr[-300:]}")


@case
def the_lab_mission(world):
    """The whole lab mission: carrier and arm are robots under ROS 2 that files describe, behind a door of Open-RMF; a person answers."""
    ada, arm = world.robot("--namespace", "/ada"), world.robot("--namespace", "/arm", "--x", "13.5", "--y", "11")
    building = world.robot("--door", "lab-door", script="building.py")
    base = ROBOT.split("readings:")[0] + ROBOT[ROBOT.index("actions:"):]
    base = "".join(line for line in base.splitlines(True) if not re.match(r"  (jam|say|release):", line))
    base = base.replace("extends: [turtlebot, nav2_moves]", "extends: [nav2]\ncharge: { topic: battery_state }\n")
    base = base.replace(", results: { note: message }", "")
    world.file("ada.yaml", base + "namespace: ada\n")
    world.file("arm.yaml", base + "namespace: arm\n")
    station, listen = free_port(), {}
    fleet = ('[fleet]\nname = "lab"\nmap = "hospital"\nbootstrap_expect = 1\n'
             '[[fleet.device]]\nname = "lab-door"\nkind = "door"\nhost = "station"\nlanes = [["Laboratory Corridor", "Laboratory"]]\n')
    world.file("station.toml", f'name = "station"\n[bus]\nlisten = ["tcp/127.0.0.1:{station}"]\n'
               f'[[device]]\nname = "lab-door"\ndriver = ["{ROS2}", "driver", "rmf_door"]\n' + fleet)
    Process(world, [CONSORT, "station", "--config", "station.toml"])
    skills = {"ada": '["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot"]', "arm": '["pick_up"]'}
    for name, place, more in (("ada", "Dock", "speed_mps = 0.5\n"), ("arm", "Laboratory", "stationary = true\n")):
        listen[name] = free_port()
        world.file(f"{name}.toml", f'name = "{name}"\nplace = "{place}"\nskills = {skills[name]}\n{more}may_vote = false\n'
                   f'driver = ["{ROS2}", "driver", "{name}.yaml"]\n[bus]\nlisten = ["tcp/127.0.0.1:{listen[name]}"]\n'
                   f'connect = ["tcp/127.0.0.1:{station}"]\n' + fleet)
        Process(world, [CONSORT, "robot", "--config", f"{name}.toml"])
    address = f"tcp/127.0.0.1:{station}"
    at = ("--fleet", "lab", "--connect", address)
    waiting = Process(world, [CONSORT, "submit", "lab-samples", *at, "--wait"])

    def request():
        ran = world.run(CONSORT, "requests", *at)
        return re.search(r"lab-samples-1\.\d+", ran.stdout)
    answer = world.run(CONSORT, "answer", wait_for("a request to the nurse", request, 120).group(), "--done", "--by", "Ana", *at)
    check(answer.returncode == 0, f"consort answer: {answer.stderr[-300:]}")
    check(waiting.child.wait(timeout=150) == 0, f"the mission fails: {waiting.errors()[-400:]}")
    ada.message("the drawer was closed at the end", is_event("drawer", open=False))
    arm.message("the arm took the sample", is_event("grip"))
    building.message("the door opens for the carrier", is_event("door", name="lab-door", mode=2))
    building.message("the door closes behind it", is_event("door", name="lab-door", mode=0))


@case
def the_tutorial(world):
    """The commands of docs/tutorials/ros2.md, as written."""
    world.robot("--namespace", "/ada")
    blocks = re.findall(r"```(\w+)(?: ([\w./]+))?\n(.*?)```", (ROOT / "docs/tutorials/ros2.md").read_text(encoding="utf-8"), re.S)
    bin_folder = world.folder / "bin"
    bin_folder.mkdir()
    for name, program in (("consort", CONSORT), ("consort-ros2", ROS2)):
        os.symlink(program, bin_folder / name)
    world.env["PATH"] = f"{bin_folder}:{world.env['PATH']}"
    played = 0
    for kind, name, text in blocks:
        if name:
            world.file(name, text)
        elif kind == "console":
            for part in text.split("$ ")[1:]:
                command, *output = part.splitlines()
                ran = world.run("bash", "-c", command, limit=120)
                for line in output:
                    # `…` stands for text that differs.
                    pattern = ".*".join(re.escape(piece) for piece in line.split("…"))
                    check(re.search(pattern, ran.stdout + ran.stderr), f"`{command}` does not print {line!r}: {ran.stdout}{ran.stderr}")
                played += 1
    check(played >= 3, f"{played} commands")


if __name__ == "__main__":
    if "--list" in sys.argv:
        SUITE.print_names()
    else:
        sys.exit(SUITE.run(sys.argv[1:], World))
