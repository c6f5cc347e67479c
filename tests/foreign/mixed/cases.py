"""The cases of run.sh. `--list` prints their names; arguments select."""
import argparse
import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[1:1] = [str(HERE.parent / folder) for folder in ("common", "ros2", "vda5050")]
from processes import wait_for
from suite import Suite, check
from world import ROS2, World, is_event

SUITE = Suite("mixed", prefix="mixed_")
case = SUITE.case


class Site:
    """What a case gets: the side of ROS 2 with all programs of the fleet, and the side of VDA 5050."""

    def __init__(self, program, kit, folder):
        from kit import Case  # needs the installed packages
        self.vda5050 = Case(program, kit, folder)
        self.ros2 = World(folder)

    def close(self):
        self.ros2.close()
        self.vda5050.close()


ROS2_ROBOT = """
extends: [nav2]
namespace: porter
pose: { topic: odom, type: nav_msgs/msg/Odometry }
charge: { topic: battery_state }
actions:
  operate_drawer: { service: drawer, type: std_srvs/srv/SetBool, send: { data: "${action == open}" }, succeeded: success }
"""

VEHICLE_ACTIONS = {
    name: {"type": kind, "blocking": "HARD",
           "parameters": {"stationType": "floor", "loadType": "EPAL", "loadId": "{load}", "duration": 1}}
    for name, kind in (("pick_load", "pick"), ("drop_load", "drop"))}

# The skills allow only one robot for each role. The first three tasks are simultaneous; each later task follows a task
# of a robot of another kind.
MISSION = """
mission: pass-load
title: Pass a load from a vehicle to a robot with a drawer
roles:
  carrier: { kind: managed, description: the vehicle of VDA 5050 }
  porter: { kind: managed, description: the robot under ROS 2 }
  scout: { kind: managed, description: the simulated robot }
root:
  task: pass_load
  method: sequential
  tasks:
    - task: prepare
      method: unordered
      tasks:
        - task: fetch
          method: sequential
          tasks:
            - { task: to_shelf, type: navigation, roles: [carrier], parameters: { to: Shelf } }
            - { task: pick, type: pick_load, roles: [carrier], parameters: { load: L-7 } }
        - { task: approach, type: navigation, roles: [porter], parameters: { to: Ward } }
        - { task: look, type: look, roles: [scout] }
    - { task: open, type: operate_drawer, roles: [porter], parameters: { action: open } }
    - { task: to_ward, type: navigation, roles: [carrier], parameters: { to: Ward } }
    - { task: inspect, type: inspect, roles: [scout] }
    - { task: drop, type: drop_load, roles: [carrier], parameters: { load: L-7 } }
    - { task: close, type: operate_drawer, roles: [porter], parameters: { action: close } }
"""


def orders(listener):
    """Returns the orders of the vehicle by their ids: the last node of the latest update, and the types of its actions."""
    return {order["orderId"]: (order["nodes"][-1]["nodeId"], [action["actionType"] for node in order["nodes"] for action in node["actions"]])
            for order in listener.of("order")}


def actions(listener):
    """Returns the actions that the vehicle has reported by their ids: type and last status."""
    return {action["actionId"]: (action["actionType"], action["actionStatus"])
            for state in listener.of("state") for action in state["actionStates"]}


@case
def a_mission_of_three_kinds_survives_its_coordinator(site):
    """A vehicle of VDA 5050, a robot under ROS 2 and a simulated robot are at work when their coordinator is killed."""
    from fleet import Fleet
    world, vda5050 = site.ros2, site.vda5050
    broker = vda5050.broker()
    listener = vda5050.listener(broker)
    vda5050.agv(broker, speed=0.5)
    porter = world.robot("--namespace", "/porter", "--x", "8", "--y", "4", "--drive-s", "8")
    fleet = Fleet(world)
    fleet.robot("carrier", "Dock", ["navigation", "pick_load", "drop_load"],
                [vda5050.program, "driver", vda5050.file(broker, actions=VEHICLE_ACTIONS)])
    fleet.robot("porter", "Bench", ["navigation", "operate_drawer"], [ROS2, "driver", world.file("porter.yaml", ROS2_ROBOT)])
    fleet.robot("scout", "Gate", ["navigation", "look", "inspect"])
    fleet.simulated("scout", "Gate")
    coordinator, term = wait_for("a coordinator and three free robots", lambda: fleet.ready(["carrier", "porter", "scout"]), 60)

    request = ["submit", world.file("mission.yaml", MISSION), "--request", "order-1"]
    mission = fleet.json(*request)["mission"]
    wait_for("the vehicle drives", lambda: any(state["driving"] for state in listener.of("state")))
    porter.message("the robot under ROS 2 drives", is_event("goal", action="navigate_to_pose"))
    wait_for("the simulated robot looks", lambda: "seen_share" in json.dumps((fleet.json("fleet") or {}).get("feedback", {}).get("scout")))
    fleet.kill(coordinator)

    def next_coordinator():
        name, next_term = fleet.coordinator()
        return (name, next_term) if name not in (None, coordinator) else None
    successor, next_term = wait_for(f"a coordinator after {coordinator}", next_coordinator)
    check(next_term > term, f"{successor} coordinates in term {next_term}, {coordinator} in {term}")
    unfinished = fleet.json("missions", mission)
    check(unfinished["state"] == "running", f"at the takeover the mission is {unfinished['state']}")

    ended = wait_for("the end of the mission", lambda: fleet.ended(mission), 120)
    check(ended["state"] == "completed" and ended["done"] == ended["steps"], f"{ended['state']}: {ended['detail']}")
    check(ended["releases"] == [], f"robots have lost roles: {ended['releases']}")
    again = fleet.json(*request)
    check((again["mission"], again["again"]) == (mission, True), f"the repeated request: {again}")
    missions = [listed["mission"] for listed in fleet.json("missions")["missions"]]
    check(missions == [mission], f"{missions}")

    # Every task once, by what the robots themselves report.
    check(sorted(orders(listener).values()) == [("n2", []), ("n2", ["pick"]), ("n3", []), ("n3", ["drop"])], f"{orders(listener)}")
    check(sorted(actions(listener).values()) == [("drop", "FINISHED"), ("pick", "FINISHED")], f"{actions(listener)}")
    reported = [event for event in porter.all() if event["event"] in ("goal", "ended", "drawer", "cancel")]
    check([event["event"] for event in reported] == ["goal", "ended", "drawer", "drawer"], f"{reported}")
    check(reported[1]["status"] == 4 and [event["open"] for event in reported[2:]] == [True, False], f"{reported}")
    readings = fleet.json("fleet")["readings"]["scout"]
    check({name: readings[name] for name in ("looks", "inspections")} == {"looks": 1, "inspections": 1}, f"{readings}")
    return f"{coordinator} coordinated in term {term}, {successor} in term {next_term}"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--program")
    parser.add_argument("--kit")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("names", nargs="*")
    arguments = parser.parse_args()
    if arguments.list:
        SUITE.print_names()
        return 0
    return SUITE.run(arguments.names, lambda folder: Site(arguments.program, arguments.kit, folder))


if __name__ == "__main__":
    sys.exit(main())
