"""Cases with genuine software of VDA 5050. Each prints `pass NAME`, `fail NAME: why` or `skip NAME: why`."""
import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "common"))
from processes import free_port, is_listening, wait_for
from suite import Skip, Suite

SUITE = Suite("vda5050")
case = SUITE.case


def starts(listener, kind):
    """Ids of the actions of a type that any vehicle has begun, as its states tell."""
    return {action["actionId"] for state in listener.of("state") for action in state["actionStates"]
            if action.get("actionType") == kind and action["actionStatus"] not in ("WAITING",)}


def is_driving(listener):
    states = listener.of("state")
    return states and states[-1]["driving"]


def is_broken(listener):
    return any(message["connectionState"] == "CONNECTIONBROKEN" for message in listener.of("connection"))


@case
def a_vehicle_of_vda_5050_lib_drives_and_acts(case):
    broker = case.broker()
    listener = case.listener(broker)
    case.agv(broker)
    driver = case.driver(broker)
    driver.wait("pose", place="Dock")
    driver.wait("charge")
    driver.drive(1, "Ward")
    driver.result(1)
    driver.wait("pose", place="Ward")
    assert any(message.get("distance_remaining_m", 0) > 1 for message in driver.all if message["type"] == "feedback")
    driver.goal(2, "pick_load", load="L-7")
    driver.result(2)
    driver.goal(3, "drop_load", load="L-7")
    driver.result(3)
    driver.goal(4, "dock")
    driver.result(4)
    driver.goal(5, "undock")
    driver.result(5)
    driver.goal(6, "pause")
    driver.result(6)
    driver.goal(7, "resume")
    driver.result(7)
    drive = [order for order in listener.of("order") if len(order["nodes"]) > 1]
    assert [order["orderUpdateId"] for order in drive] == [0, 1], drive
    assert drive[0]["orderId"] == drive[1]["orderId"] and drive[1]["nodes"][0]["nodeId"] == "n2", "stitched at n2"
    assert [node["released"] for node in drive[0]["nodes"]] == [True, True, False], "base and horizon"
    assert starts(listener, "pick"), "the vehicle executed the action"


@case
def a_vehicle_of_vda5050_sdk_drives_and_acts(case):
    broker = case.broker()
    case.sdk_vehicle(broker)
    driver = case.driver(broker, "sdk-1", version="2.1")
    driver.wait("pose")
    driver.drive(1, "Ward")
    driver.result(1)
    driver.goal(2, "pick_load", load="L-7")
    driver.result(2)
    driver.goal(3, "dock")
    driver.result(3)


@case
def every_message_fits_the_official_schemas(case):
    import jsonschema
    import vda5050.validation
    broker = case.broker()
    listener = case.listener(broker)
    case.sdk_vehicle(broker)
    driver = case.driver(broker, "sdk-1", version="2.1")
    driver.drive(1, "Ward")
    driver.result(1)
    driver.goal(2, "pick_load", load="L-7")
    driver.result(2)
    driver.goal(3, "dock")
    driver.result(3)
    driver.drive(4, "Dock")
    driver.wait("feedback", id="4")
    driver.send("cancel", id="4")
    driver.wait("result", id="4")
    folder = Path(vda5050.validation.__file__).parent / "schemas"
    counts = {}
    for level in ("order", "instantActions", "state", "connection"):
        official = json.loads((folder / f"{level}.json").read_text())
        printed = subprocess.run([case.program, "schema", level, "--vda", "2.1"], capture_output=True, text=True, check=True)
        for message in listener.of(level):
            jsonschema.validate(message, official)
            jsonschema.validate(message, json.loads(printed.stdout))
            counts[level] = counts.get(level, 0) + 1
    assert min(counts.get(level, 0) for level in ("order", "instantActions", "state", "connection")) > 0, counts
    return ", ".join(f"{count} {level}" for level, count in counts.items())


def published_schema(file):
    """A schema as it is published: some of 3.0 have a comma before a closing bracket, which is no JSON."""
    return json.loads(re.sub(r",(\s*[}\]])", r"\1", file.read_text()))


@case
def messages_of_3_0_fit_the_official_schemas(case):
    import jsonschema
    folder = case.official_schemas("3.0.0")
    if folder is None:
        raise Skip("the official schemas of 3.0 are in none of the packages, and their repository cannot be reached; "
                   "CONSORT_VDA5050_SCHEMAS=FOLDER names a copy of its folder json_schemas")
    # Both sides are of this project: the driver, and a simulated vehicle.
    broker = case.broker()
    listener = case.listener(broker)
    case.vehicles(broker, version="3.0")
    driver = case.driver(broker, "ada", version="3.0", manufacturer="Consort", places=case.PLACES,
                         edges=[["Dock", "Shelf"], ["Shelf", "Ward"]])
    driver.drive(1, "Ward")
    driver.result(1)
    driver.goal(2, "pick_load", load="L-7")
    driver.result(2)
    counts = {}
    for level in ("order", "instantActions", "state", "connection", "visualization", "factsheet"):
        official = published_schema(folder / f"{level}.schema")
        for message in listener.of(level):
            jsonschema.validate(message, official)
            counts[level] = counts.get(level, 0) + 1
    assert len(counts) == 6, counts
    return ", ".join(f"{count} {level}" for level, count in counts.items())


@case
def a_foreign_fleet_control_drives_a_simulated_vehicle(case):
    from kit import Process
    broker = case.broker()
    listener = case.listener(broker)
    vehicles = case.vehicles(broker)
    wait_for("the vehicle is online", lambda: [message["connectionState"] for message in listener.of("connection", "ada")] == ["ONLINE"])
    log = case.folder / "master.txt"
    with open(log, "wb") as output:
        case.keep(Process(["node", HERE / "master.js", case.kit, broker.url, "ada"], case.folder / "master.log", stdout=output))
        wait_for("all orders end", lambda: "order-to-Dock" in log.read_text(), 60)
    ended = [line for line in log.read_text().splitlines() if line.startswith("ended")]
    assert ended == ["ended order-to-Ward done", "ended order-to-Shelf done", "ended order-to-Dock cancelled"], log.read_text()
    assert starts(listener, "pick"), "the robot executed the action"
    vehicles.kill(signal.SIGTERM)
    wait_for("the vehicle is offline", lambda: listener.of("connection", "ada")[-1]["connectionState"] == "OFFLINE")


@case
def a_foreign_vehicle_of_3_0_drives(case):
    raise Skip("none of the packages contains a vehicle of 3.0")


@case
def ten_vehicles_drive_at_the_same_time(case):
    broker = case.broker()
    listener = case.listener(broker)
    case.agv(broker, 10)
    drivers = [case.driver(broker, f"agv-{number}") for number in range(1, 11)]
    for number, driver in enumerate(drivers, 1):
        driver.drive(number, "Ward")
    for number, driver in enumerate(drivers, 1):
        driver.result(number, limit_s=60)
    for number in range(1, 11):
        ids = {order["orderId"] for order in listener.of("order", f"agv-{number}")}
        assert len(ids) == 1 and f"-{number}-" in ids.pop(), "each vehicle received its own order"


@case
def a_drive_survives_a_restart_of_the_broker(case):
    broker = case.broker()
    listener = case.listener(broker)
    case.agv(broker, speed=0.8)
    driver = case.driver(broker)
    driver.drive(1, "Ward")
    wait_for("the vehicle drives", lambda: is_driving(listener))
    broker.kill()
    wait_for("the driver notices the loss", lambda: "no connection to the broker; trying again" in driver.errors.read_text())
    broker.start()
    driver.result(1, limit_s=60)
    driver.drive(2, "Shelf")
    driver.result(2, limit_s=60)


@case
def repeated_and_late_messages_change_nothing(case):
    broker = case.broker()
    listener = case.listener(broker)
    case.agv(broker)
    driver = case.driver(broker)
    driver.drive(1, "Ward")
    driver.result(1)
    recorded = [(topic, payload) for topic, payload in listener.messages if topic.endswith(("/order", "/state"))]
    before = len(listener.of("order"))
    # An hour later, everything again: old orders to the vehicle, and old states to the driver.
    for topic, payload in recorded:
        listener.client.publish(topic, payload)
    # The vehicle executes a late order that arrives in the next drive; the drive is then ordered again.
    wait_for("the old orders have arrived", lambda: len(listener.of("order")) == 2 * before, 20)
    driver.drive(2, "Shelf")
    driver.result(2)
    ids = [order["orderId"] for order in listener.of("order")[before:]]
    new = {id for id in ids if "-2-" in id}
    assert len(new) == 1, ids
    wait_for("the vehicle ends the drive", lambda: listener.of("state")[-1]["lastNodeId"] == "n2", 20)
    assert [message["id"] for message in driver.all if message["type"] == "result"] == ["1", "2"]


@case
def a_vehicle_that_restarts_in_a_drive_drives_again(case):
    broker = case.broker()
    listener = case.listener(broker)
    agv = case.agv(broker, speed=0.5)
    driver = case.driver(broker)
    driver.drive(1, "Ward")
    wait_for("the vehicle drives", lambda: is_driving(listener))
    agv.kill()
    wait_for("the last will of the vehicle", lambda: is_broken(listener))
    case.agv(broker, speed=4)
    driver.result(1, limit_s=60)
    ids = {order["orderId"] for order in listener.of("order")}
    assert len(ids) == 2 and any(id.endswith("-1") for id in ids), ids


@case
def a_vehicle_that_restarts_in_an_action_does_not_repeat_it(case):
    broker = case.broker()
    listener = case.listener(broker)
    agv = case.agv(broker)
    driver = case.driver(broker)
    driver.goal(1, "pick_load", load="L-7")
    wait_for("the action begins", lambda: starts(listener, "pick"))
    agv.kill()
    case.agv(broker)
    result = driver.result(1, "aborted", limit_s=60)
    assert "not repeated" in result["message"], result
    assert len(listener.of("order")) == 1


@case
def a_vehicle_and_a_driver_that_restart_do_not_repeat_an_action(case):
    broker = case.broker()
    listener = case.listener(broker)
    agv = case.agv(broker)
    driver = case.driver(broker)
    driver.goal(1, "pick_load", load="L-7")
    wait_for("the action begins", lambda: starts(listener, "pick"))
    driver.kill()
    agv.kill()
    case.agv(broker)
    driver = case.driver(broker)
    driver.goal(1, "pick_load", resumed=True, load="L-7")
    result = driver.result(1, "aborted", limit_s=60)
    assert "not repeated" in result["message"], result
    assert len(listener.of("order")) == 1


@case
def a_vehicle_that_loses_its_connection_continues(case):
    broker = case.broker()
    listener = case.listener(broker)
    agv = case.agv(broker, speed=0.8)
    driver = case.driver(broker)
    driver.drive(1, "Ward")
    driver.wait("feedback", id="1")
    agv.child.send_signal(signal.SIGSTOP)
    wait_for("the last will of the vehicle", lambda: is_broken(listener))
    agv.child.send_signal(signal.SIGCONT)
    driver.result(1, limit_s=60)


@case
def a_robot_is_out_of_service_while_its_vehicle_is_offline(case):
    broker = case.broker()
    agv = case.agv(broker)
    driver = case.driver(broker)

    def is_able():
        return [message["able"] for message in list(driver.all) if message["type"] == "charge"][-1:] == [True]
    wait_for("the robot is in service", is_able)
    agv.kill()
    wait_for("the robot is out of service", lambda: not is_able())
    case.agv(broker)
    wait_for("the robot is in service again", is_able)


@case
def a_restarted_node_takes_the_end_of_an_action_from_the_vehicle(case):
    from kit import wait_for
    broker = case.broker()
    listener = case.listener(broker)
    case.agv(broker)
    driver = case.driver(broker)
    driver.goal(1, "pick_load", load="L-7")
    wait_for("the action begins", lambda: starts(listener, "pick"))
    driver.kill()
    wait_for("the action ends", lambda: [action for action in listener.of("state")[-1]["actionStates"]
                                         if action.get("actionType") == "pick" and action["actionStatus"] == "FINISHED"])
    driver = case.driver(broker)
    driver.goal(1 << 20, "pick_load", since=1, load="L-7")
    driver.result(1 << 20)
    assert len(starts(listener, "pick")) == 1 and len(listener.of("order")) == 1, "the action is executed once"
    # The node has recorded the end, and a later task asks for the same. The vehicle picks a load once, so it drops it before.
    driver.goal((1 << 20) + 1, "drop_load", load="L-7")
    driver.result((1 << 20) + 1)
    driver.goal((1 << 20) + 2, "pick_load", load="L-7")
    driver.result((1 << 20) + 2)
    assert len(starts(listener, "pick")) == 2, "a new request"


@case
def a_killed_driver_continues_its_action_without_repeating_it(case):
    broker = case.broker()
    listener = case.listener(broker)
    case.agv(broker)
    driver = case.driver(broker)
    driver.goal(1, "pick_load", load="L-7")
    wait_for("the action begins", lambda: starts(listener, "pick"))
    driver.kill()
    driver = case.driver(broker)
    driver.goal(1, "pick_load", resumed=True, load="L-7")
    driver.result(1)
    assert len(starts(listener, "pick")) == 1 and len(listener.of("order")) == 1, "the action is executed once"
    # The same for a drive, whose horizon the next process releases.
    driver.drive(2, "Ward")
    driver.wait("feedback", id="2")
    wait_for("the order is under way", lambda: listener.of("state")[-1]["orderId"].startswith("consort-2-"))
    driver.kill()
    driver = case.driver(broker)
    driver.drive(2, "Ward", resumed=True)
    driver.result(2)
    ids = {order["orderId"] for order in listener.of("order") if order["orderId"].startswith("consort-2-")}
    assert len(ids) == 1, ids


@case
def a_restarted_node_continues_the_drive_under_way(case):
    broker = case.broker()
    listener = case.listener(broker)
    case.agv(broker, speed=0.8)
    driver = case.driver(broker)
    driver.drive(1, "Ward")
    wait_for("the order is under way", lambda: listener.of("state") and listener.of("state")[-1]["orderId"].startswith("consort-1-"))
    driver.kill()
    driver = case.driver(broker)
    driver.drive(1 << 20, "Ward")
    driver.result(1 << 20)
    assert {order["orderId"].split("-")[1] for order in listener.of("order")} == {"1"}


@case
def a_cancel_and_the_end_of_the_input_stop_the_vehicle(case):
    broker = case.broker()
    listener = case.listener(broker)
    case.agv(broker, speed=0.8)
    driver = case.driver(broker)
    driver.drive(1, "Ward")
    wait_for("the vehicle drives", lambda: is_driving(listener))
    driver.send("cancel", id="1")
    driver.result(1, "canceled", limit_s=10)
    state = listener.of("state")[-1]
    assert not state["driving"] and not state["nodeStates"], state
    driver.drive(2, "Ward")
    wait_for("the vehicle drives again", lambda: listener.of("state")[-1]["driving"])
    driver.goal_id = None  # the permission ends
    driver.result(2, "canceled", limit_s=10)
    driver.drive(3, "Ward")
    wait_for("the vehicle drives a third time", lambda: listener.of("state")[-1]["driving"])
    driver.goal_id = None
    driver.process.child.stdin.close()
    assert driver.process.child.wait(4) == 0
    wait_for("the vehicle stands", lambda: not listener.of("state")[-1]["driving"], 5)


@case
def errors_of_a_vehicle_become_causes(case):
    broker = case.broker()
    case.agv(broker)
    driver = case.driver(broker)
    driver.wait("pose")
    driver.goal(1, "pick_load", load="L-7")
    driver.result(1)
    # The vehicle carries a load already.
    driver.goal(2, "pick_load", load="L-8")
    result = driver.result(2, "aborted")
    assert result["code"] == "failed" and result["message"], result
    driver.goal(3, "navigate_to_pose", pose={"x_m": 99, "y_m": 0})
    result = driver.result(3, "aborted")
    assert result["code"] == "no_route" and "allowed: Dock, Shelf, Ward" in result["message"], result


@case
def malformed_messages_are_refused_with_their_path(case):
    broker = case.broker()
    listener = case.listener(broker)
    case.agv(broker)
    driver = case.driver(broker)
    driver.wait("pose")
    state = listener.of("state", "agv-1")[-1]
    topic = "uagv/v2/Foreign/agv-1/state"
    wrong = [{**state, "errors": [{"errorType": "x", "errorLevel": "LOUD"}]}, {**state, "orderUpdateId": "one"},
             {**state, "serialNumber": "agv-2"}, {key: value for key, value in state.items() if key != "driving"}]
    for message in [*(json.dumps(message) for message in wrong), "{", b"\xff"]:
        listener.client.publish(topic, message)
    driver.drive(1, "Shelf")
    driver.result(1)
    driver.goal_id = None
    driver.process.child.stdin.close()
    assert driver.process.child.wait(10) == 0
    text = driver.errors.read_text()
    for part in ["/errors/0/errorLevel", "properties/errorLevel/enum", "/orderUpdateId", "/serialNumber", "`driving` is missing", "no JSON"]:
        assert part in text, f"{part} is not in {text[-2000:]}"
    # The log names the first refusals, and the end of the driver counts them all.
    assert '{"state": 6}' in text, f"the refusals are not counted in {text[-500:]}"


@case
def topics_of_others_are_not_touched(case):
    broker = case.broker()
    listener = case.listener(broker)
    case.agv(broker, 2)
    driver = case.driver(broker)
    other = "uagv/v2/Other/agv-1"
    listener.client.publish(f"{other}/connection", json.dumps({"connectionState": "OFFLINE"}), retain=True)
    driver.drive(1, "Ward")
    driver.result(1)
    driver.goal(2, "dock")
    driver.result(2)
    own = "uagv/v2/Foreign/agv-1/"
    lines = [line for line in broker.text().splitlines() if "consort-" in line]
    published = [line for line in lines if "Received PUBLISH from consort-" in line]
    delivered = [line for line in lines if "Sending PUBLISH to consort-" in line]
    assert published and delivered
    assert all(own in line for line in published + delivered), "only topics of the own vehicle"
    subscribed = {line.split()[1] for line in broker.text().splitlines() if line.split()[1:2] and line.split()[1].startswith(own)}
    assert {f"{own}{level}" for level in ("state", "visualization", "connection", "factsheet")} <= subscribed, subscribed


@case
def a_broker_with_tls_and_passwords_is_used(case):
    if not shutil.which("openssl"):
        raise Skip("openssl is not installed")
    folder = case.folder

    def openssl(*words):
        subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)
    openssl("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2", "-subj", "/CN=ca",
            "-keyout", "ca.key", "-out", "ca.pem")
    openssl("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-subj", "/CN=localhost", "-keyout", "broker.key", "-out", "broker.csr")
    (folder / "names").write_text("subjectAltName=IP:127.0.0.1,DNS:localhost\nbasicConstraints=CA:FALSE\n")
    openssl("x509", "-req", "-in", "broker.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2", "-extfile", "names", "-out", "broker.pem")
    subprocess.run(["mosquitto_passwd", "-b", "-c", "users", "consort", "secret"], cwd=folder, check=True, capture_output=True)
    (folder / "password").write_text("secret\n")
    (folder / "wrong").write_text("guess\n")
    plain = free_port()
    broker = case.broker([f"cafile {folder}/ca.pem", f"certfile {folder}/broker.pem", f"keyfile {folder}/broker.key",
                          f"password_file {folder}/users", "allow_anonymous false"], scheme="mqtts")
    access = {"user": "consort", "password_file": "password", "ca": "ca.pem"}
    check = lambda **more: subprocess.run([case.program, "check", str(case.file(broker, name="check", access={**access, **more})), "--connect", "2"],
                                          capture_output=True, text=True)
    refused = check(password_file="wrong")
    assert refused.returncode == 1 and "NotAuthorized" in refused.stdout, refused
    # Without the authority the broker's certificate is not accepted.
    (folder / "other.pem").write_bytes((folder / "ca.pem").read_bytes())
    openssl("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2", "-subj", "/CN=other", "-keyout", "other.key", "-out", "other.pem")
    untrusted = check(ca="other.pem")
    assert untrusted.returncode == 1 and "certificate" in untrusted.stdout.lower(), untrusted
    accepted = check()
    assert "NotAuthorized" not in accepted.stdout and "problem" not in accepted.stdout, accepted
    assert f"consort-check" in broker.text() and "u'consort'" in broker.text(), "the broker knows the user"
    return "connection, user and refusals; the virtual vehicle has no TLS"


@case
def the_broker_of_vda_5050_cli_is_used(case):
    from kit import Process
    port = free_port()
    command = [case.kit / "node_modules/.bin/vda-5050", "broker", "-q", "-p", port, "--ws-port", free_port()]
    case.keep(Process(command, case.folder / "cli.log", stdout=subprocess.DEVNULL))
    wait_for("the broker listens", lambda: is_listening(port), 20)
    url = f"mqtt://127.0.0.1:{port}"
    case.agv(url)
    driver = case.driver(url)
    driver.drive(1, "Shelf")
    driver.result(1)


@case
def the_vehicle_is_checked_by_its_factsheet(case):
    broker = case.broker()
    case.agv(broker)
    file = case.file(broker)
    output = subprocess.run([case.program, "check", str(file), "--connect", "5"], capture_output=True, text=True)
    assert output.returncode == 0, output
    for part in ["vehicle Foreign/agv-1, VDA 5050 2.0.0", "action  pick_load: action on the node pick, blocking HARD", "state   mode AUTOMATIC", "factsheet"]:
        assert part in output.stdout, f"{part!r} is not in {output.stdout}"


@case
def the_driver_passes_the_conformance_check(case):
    root = Path(__file__).resolve().parents[3]
    target = Path(os.environ.get("CARGO_TARGET_DIR", root / "target"))
    programs = [Path(os.environ[name]) for name in ["CONSORT"] if name in os.environ]
    programs += [target / "release/consort", target / "debug/consort"]
    consort = next((program for program in programs if program.exists()), None)
    if consort is None:
        raise Skip("the program consort is not built: cargo build, or CONSORT=PATH")
    broker = case.broker()
    case.agv(broker, speed=1.0)
    file = case.file(broker, actions={
        "wait_in_place": {"type": "noop", "blocking": "HARD", "parameters": {"duration": 2}, "example": {}}})
    domain = case.folder / "domain.yaml"
    domain.write_text("domain: foreign\ndescription: actions of the virtual vehicle\nactions:\n  wait_in_place:\n    description: stands still\n"
                      "    repeatable: true\n    simulate: { duration_s: [2, 2] }\n")
    command = [consort, "driver", "check", "--domain", domain, "--goal", '{"action": "wait_in_place", "parameters": {}}', "--", case.program, "driver", file]
    output = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=600)
    failed = [line for line in output.stdout.splitlines() if line.startswith("FAILED")]
    assert output.returncode == 0, failed or output.stderr[-500:]
    return f"{sum(line.startswith('ok') for line in output.stdout.splitlines())} cases of consort driver check"


@case
def the_tutorial_works(case):
    import tutorial
    return tutorial.play(case)


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
    from kit import Case  # needs the installed packages
    return SUITE.run(arguments.names, lambda folder: Case(arguments.program, arguments.kit, folder))


if __name__ == "__main__":
    sys.exit(main())
