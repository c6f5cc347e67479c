//! Drivers in other languages: the example passes the conformance check, and broken variants of it fail
//! in the right case.

use super::support::{CommandOutput, crate_file, run, test_file};
use serde_json::Value;
use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};

fn example(name: &str) -> String {
    crate_file(&format!("../../examples/vacuum/{name}"))
}

/// Runs cases of the check on a driver; all without cases.
fn check(driver: &str, cases: &[&str], flags: &[&str]) -> CommandOutput {
    let domain = example("domain.yaml");
    let mut args = vec!["driver", "check", "--jobs", "4", "--domain", &domain];
    args.extend(flags);
    args.extend(cases.iter().flat_map(|case| ["--case", case]));
    args.extend(["--", "python3", driver]);
    run(&args)
}

/// Writes the example with a part of its text replaced.
fn variant(name: &str, from: &str, to: &str) -> String {
    let text = std::fs::read_to_string(example("driver.py")).expect("an example");
    assert_eq!(text.matches(from).count(), 1, "{from}");
    test_file(name, &text.replace(from, to))
}

#[test]
fn the_example_driver_passes_every_case() {
    let ran = check(&example("driver.py"), &[], &[]);
    let listed = run(&["driver", "check", "--list"]);
    let cases: Vec<&str> = listed.out.lines().filter_map(|line| line.split_whitespace().next()).collect();
    assert!(cases.len() >= 30, "{}", listed.out);
    let expected: Vec<String> = cases.iter().map(|case| format!("ok      {case}")).collect();
    assert_eq!(ran.out.lines().collect::<Vec<_>>(), expected, "{}", ran.err);
    assert_eq!(ran.code, Some(0));
    let text = std::fs::read_to_string(example("driver.py")).expect("an example");
    assert!(text.lines().count() <= 80, "the example stays short");
}

#[test]
fn the_driver_of_a_door_serves_until_it_is_canceled() {
    let [domain, driver] = ["../../skills/domains/devices.yaml", "../../examples/door/driver.py"].map(crate_file);
    let cases = [
        "hello_is_accepted",
        "pose_is_reported",
        "charge_is_reported",
        "heartbeat_is_answered_during_a_goal",
        "bad_json_is_reported",
        "cancel_stops_the_goal",
        "repeated_cancel_is_ignored",
        "end_of_input_ends_the_process",
    ];
    let mut args = vec!["driver", "check", "--jobs", "4", "--domain", &domain];
    args.extend(cases.iter().flat_map(|case| ["--case", case]));
    args.extend(["--", "python3", &driver]);
    let ran = run(&args);
    let passed = ran.out.lines().filter(|line| line.starts_with("ok ")).count();
    assert_eq!((ran.code, passed), (Some(0), cases.len()), "{}{}", ran.out, ran.err);
}

/// A program that listens on a socket.
struct Listener(Child);

impl Drop for Listener {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs a driver for each connection of a socket, and returns when it listens.
fn listen(socket: &str, driver: &str) -> Listener {
    let program = crate_file("tests/data/listen.py");
    let child = Command::new("python3").args([&program, socket, "python3", driver]).stdout(Stdio::piped()).spawn();
    let mut child = child.expect("there is a program `python3`");
    let mut line = String::new();
    let output = child.stdout.take().expect("it is a pipe");
    BufReader::new(output).read_line(&mut line).expect("its output is read");
    assert_eq!(line, "listening\n");
    Listener(child)
}

#[test]
fn a_driver_on_a_socket_passes_every_case_but_those_of_processes() {
    let (socket, domain) = (concat!(env!("CARGO_TARGET_TMPDIR"), "/check.sock"), example("domain.yaml"));
    // The socket of an earlier run.
    let _ = std::fs::remove_file(socket);
    let check =
        || run(&["driver", "check", "--jobs", "4", "--domain", &domain, "--connect", &format!("unix:{socket}")]);
    let alone = check();
    assert_eq!(alone.code, Some(1), "{}", alone.err);
    assert!(alone.out.contains("FAILED  goal_succeeds: no connection to unix:"), "{}", alone.out);
    let _listener = listen(socket, &example("driver.py"));
    let ran = check();
    let expected = "skipped end_of_input_ends_the_process: it needs a process\n\
                    skipped end_of_input_during_a_goal_ends_the_process: it needs a process\n\
                    skipped shutdown_ends_the_process: it needs a process\n";
    let others: String =
        ran.out.lines().filter(|line| !line.starts_with("ok ")).map(|line| format!("{line}\n")).collect();
    assert_eq!((ran.code, others.as_str()), (Some(0), expected), "{}", ran.err);
    assert!(ran.out.lines().count() >= 30, "{}", ran.out);
}

#[test]
fn a_driver_that_ignores_cancels_fails_the_case_of_cancels() {
    let driver =
        variant("ignores_cancel.py", r#"kind == "cancel" and id == self.goal"#, r#"kind == "cancel" and False"#);
    let ran = check(&driver, &["goal_succeeds", "cancel_stops_the_goal", "deadline_stops_the_goal"], &[]);
    let expected = "ok      goal_succeeds\nFAILED  cancel_stops_the_goal: the goal has ended as succeeded, not as canceled\n\
                    ok      deadline_stops_the_goal\n";
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), expected), "{}", ran.err);
    assert!(ran.err.contains("1 of 3 cases failed"), "{}", ran.err);
}

#[test]
fn a_driver_that_acts_without_permission_fails_the_case_of_deadlines() {
    let driver = variant("ignores_keep.py", "now >= self.keep_until", "False");
    let ran = check(&driver, &["cancel_stops_the_goal", "deadline_stops_the_goal"], &["--json"]);
    let reports: Vec<Value> = ran.out.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!((&reports[0]["case"], &reports[0]["ok"]), (&"cancel_stops_the_goal".into(), &true.into()));
    assert_eq!(reports[1]["problem"], "the goal has ended as succeeded, not as canceled", "{}", ran.out);
}

#[test]
fn a_driver_that_prints_text_fails_the_case_of_messages() {
    let driver = variant(
        "prints.py",
        r#"send("readings", values={"bag_g": round(self.dust, 2)})"#,
        "print(f'dust: {self.dust}', flush=True)",
    );
    let ran = check(&driver, &["goal_succeeds", "output_is_messages"], &[]);
    let lines: Vec<&str> = ran.out.lines().collect();
    assert_eq!((ran.code, lines[0]), (Some(1), "ok      goal_succeeds"));
    assert!(lines[1].starts_with("FAILED  output_is_messages: a line is no message: \"dust: 0.0\": "), "{}", ran.out);
}

#[test]
fn a_driver_with_undeclared_readings_fails_the_case_of_readings() {
    let driver = variant("undeclared_reading.py", r#"values={"bag_g": "#, r#"values={"bag": "#);
    let ran = check(&driver, &["goal_succeeds", "readings_are_declared", "output_is_messages"], &[]);
    let expected = "ok      goal_succeeds\nFAILED  readings_are_declared: readings: values.bag: no domain declares this reading; \
                    allowed: bag_g; did you mean `bag_g`?\nok      output_is_messages\n";
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), expected), "{}", ran.err);
}

#[test]
fn a_driver_with_undeclared_feedback_fails_the_case_of_feedback() {
    let distance = "distance_remaining_m=math.dist(self.at, self.target)";
    let driver = variant("undeclared_feedback.py", distance, &format!("{distance}, values={{\"dust\": 1}}"));
    let ran = check(&driver, &["goal_succeeds", "goal_sends_feedback", "feedback_is_declared"], &[]);
    let expected = "ok      goal_succeeds\nok      goal_sends_feedback\nFAILED  feedback_is_declared: feedback: values.dust: \
                    the action vacuum declares no such feedback; no names are available\n";
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), expected), "{}", ran.err);
}

#[test]
fn a_driver_that_floods_fails_the_case_of_bounded_output() {
    let report = "if now - self.reported >= 0.5: self.report()";
    let driver = variant("floods.py", report, "[self.report() for _ in range(50)]");
    let ran = check(&driver, &["output_is_bounded", "output_is_messages"], &[]);
    let lines: Vec<&str> = ran.out.lines().collect();
    assert!(
        lines[0].starts_with("FAILED  output_is_bounded: ") && lines[0].ends_with("allowed: 100 a second"),
        "{}",
        ran.out
    );
    assert_eq!((ran.code, lines[1]), (Some(1), "ok      output_is_messages"));
}

#[test]
fn a_driver_that_crashes_in_a_goal_fails_the_case_of_goals() {
    let driver = variant(
        "crashes.py",
        "if part == 1.0 and self.work_s <= 0:",
        "if self.work_s < 1.0: sys.exit(7)\n            if False:",
    );
    let ran = check(&driver, &["heartbeat_is_answered", "goal_succeeds", "end_of_input_ends_the_process"], &[]);
    let expected = "ok      heartbeat_is_answered\nFAILED  goal_succeeds: the process has ended (exit status: 7)\n\
                    ok      end_of_input_ends_the_process\n";
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), expected), "{}", ran.err);
}

#[test]
fn a_driver_that_outlives_its_node_fails_the_case_of_streams() {
    let driver = variant("outlives.py", "while data:", "while True:");
    let ran = check(&driver, &["end_of_input_ends_the_process", "shutdown_ends_the_process"], &[]);
    let expected = "FAILED  end_of_input_ends_the_process: the process has not ended within 3s\nok      shutdown_ends_the_process\n";
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), expected), "{}", ran.err);
}

#[test]
fn wrong_usage_of_the_check_is_reported() {
    let driver = example("driver.py");
    let ran = run(&["driver", "check", "--case", "hello_is_accepted", "--", "python3", &driver]);
    assert_eq!(ran.code, Some(1), "without the domain its actions are undeclared");
    assert!(ran.out.contains("hello: actions.empty_bag: no domain declares this action; allowed: "), "{}", ran.out);
    let ran = run(&["driver", "check", "--case", "goal_suceeds", "--", "python3", &driver]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("there is no case goal_suceeds") && ran.err.contains("`goal_succeeds`"), "{}", ran.err);
    let ran = run(&["driver", "check", "--", "no-such-program"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("the program \"no-such-program\" was not found"), "{}", ran.err);
    let ran = run(&["driver", "check"]);
    assert!(ran.code == Some(2) && ran.err.contains("PROGRAM"), "{}", ran.err);
}

#[test]
fn the_driver_of_a_robot_file_is_checked() {
    let (domain, robot) = (example("domain.yaml"), example("robot.toml"));
    let ran = run(&["check", &robot, "--domain", &domain]);
    assert_eq!((ran.code, ran.out), (Some(0), format!("{robot}: ok, a robot: cleaner\n")), "{}", ran.err);
    let printed = run(&["robot", "--config", &robot, "--domain", &domain, "--print-config"]);
    let script = std::path::absolute(example("driver.py")).expect("a path").display().to_string();
    assert!(
        printed.out.contains("driver.py\"]") && !printed.out.contains("\"driver.py\"]"),
        "{script}\n{}",
        printed.out
    );
    let empty = test_file("empty_driver.toml", "name = \"a\"\nplace = \"Dock\"\nskills = [\"pick_up\"]\ndriver = []\n");
    let ran = run(&["check", &empty]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.out.contains(&format!("{empty}: driver: the list is empty; it contains a program")), "{}", ran.out);
    for (name, driver, expected) in [
        ("no_socket.toml", "driver.sock", "driver: \"driver.sock\" is no socket; allowed is `unix:PATH`"),
        ("open_socket.toml", "tcp:0.0.0.0:7700", "driver: 0.0.0.0:7700 is not a loopback address"),
    ] {
        let text = format!("name = \"a\"\nplace = \"Dock\"\nskills = [\"pick_up\"]\ndriver = {driver:?}\n");
        let file = test_file(name, &text);
        let ran = run(&["check", &file]);
        assert_eq!(ran.code, Some(1));
        assert!(ran.out.contains(&format!("{file}: {expected}")), "{}", ran.out);
    }
    let wrong = test_file(
        "wrong_driver.toml",
        "name = \"a\"\nplace = \"Dock\"\nskills = [\"pick_up\"]\ndriver = [\"no-such-program\"]\n",
    );
    let ran = run(&["robot", "--config", &wrong]);
    assert_eq!(ran.code, Some(2));
    assert!(
        ran.err.contains("driver: the program \"no-such-program\" was not found; allowed is a path"),
        "{}",
        ran.err
    );
}
