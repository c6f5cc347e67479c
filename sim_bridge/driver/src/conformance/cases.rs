//! The cases.

use super::probe::{GOAL_LIMIT, Probe, REPLY_LIMIT, check_hello, failed, sample, word};
use super::{CaseFailure, SampleGoal, Trial};
use crate::messages::{DriverMessage, NodeMessage, ResultStatus};
use consort_protocol::ids::ActionName;
use consort_skills::actions::{GoalId, JsonObject};
use futures::future::BoxFuture;
use std::time::{Duration, Instant};

/// Time for the end of a process after the end of its input, or a shutdown message.
const EXIT_LIMIT: Duration = Duration::from_secs(3);

/// Time for the first pose and charge.
const REPORT_LIMIT: Duration = Duration::from_secs(3);

/// Lines per second that a driver may write during a goal: half the rate at which a node throttles.
const LINES_PER_S_MAX: f64 = 100.0;

/// Heartbeats of the flood.
const FLOOD: u64 = 2_000;

/// A case.
pub struct Case {
    /// Name.
    pub name: &'static str,
    /// What a driver does.
    pub what: &'static str,
    pub(super) run: for<'a> fn(&'a Trial) -> BoxFuture<'a, Result<(), CaseFailure>>,
}

impl Case {
    /// Checks whether the case is about the end of a process. It is skipped for a driver that listens on a socket.
    pub fn needs_process(&self) -> bool {
        self.name.ends_with("ends_the_process")
    }
}

macro_rules! cases {
    ($($name:ident: $what:literal,)*) => {
        /// All cases, in the order of the reference.
        pub const CASES: &[Case] = &[
            $(Case {
                name: stringify!($name),
                what: $what,
                run: |trial| Box::pin($name(trial)),
            },)*
        ];
    };
}

cases! {
    hello_is_the_first_line: "its first line is the hello, within 10 s",
    hello_is_accepted: "its hello has protocol 1, and only standard actions or actions of a domain file",
    pose_is_reported: "it reports a pose within 3 s",
    charge_is_reported: "it reports a charge within 3 s",
    readings_are_declared: "it sends only readings that a domain file declares, with their types",
    heartbeat_is_answered: "it returns a heartbeat within 2 s",
    heartbeats_are_answered_in_order: "it returns every heartbeat, in order",
    heartbeat_is_answered_during_a_goal: "it returns heartbeats while it executes a goal",
    bad_json_is_reported: "it answers a line that is no JSON with `error`, and continues",
    unknown_message_is_ignored: "it ignores a message of an unknown type",
    unknown_field_is_ignored: "it ignores an unknown field of a message",
    empty_line_is_ignored: "it continues after an empty line",
    long_line_is_read: "it reads a line of 60000 bytes",
    invalid_utf8_is_survived: "it continues after a line that is not UTF-8",
    split_line_is_joined: "it reads a line that arrives in two parts",
    joined_lines_are_split: "it reads two lines that arrive together",
    unknown_action_is_rejected: "it ends a goal of an unknown action as `aborted`",
    wrong_parameters_are_survived: "it answers heartbeats after a goal with wrong parameters",
    goal_succeeds: "it ends a goal as `succeeded`",
    goal_returns_its_results: "a completed goal returns the results that its action declares",
    goal_sends_feedback: "it sends feedback during a goal",
    feedback_is_declared: "its feedback has only values that its action declares, with their types",
    goal_has_a_single_result: "it sends a single result for a goal",
    next_goal_succeeds: "it executes another goal after the first",
    repeated_goal_starts_nothing: "a goal with the id of the goal in progress starts nothing",
    ended_goal_is_not_repeated: "a goal with the id of an ended goal starts nothing",
    cancel_stops_the_goal: "it ends a goal as `canceled` within 2 s of its cancel, or within the declared time",
    repeated_cancel_is_ignored: "it ignores a cancel of a goal that has ended",
    cancel_of_an_unknown_goal_is_ignored: "it ignores a cancel of a goal that it does not know",
    deadline_stops_the_goal: "it ends a goal as `canceled` when its permission has passed",
    keep_extends_the_deadline: "it continues a goal whose permission is renewed",
    keep_of_an_ended_goal_is_ignored: "it ignores the renewal of a goal that has ended",
    goal_without_permission_is_not_executed: "it ends a goal with `keep_for_ms` 0 as `canceled`",
    goal_is_answered_after_a_restart: "its next process continues a goal of a killed one, or ends it",
    end_of_input_ends_the_process: "it ends within 3 s of the end of its input",
    end_of_input_during_a_goal_ends_the_process: "it ends within 3 s of the end of its input, also during a goal",
    shutdown_ends_the_process: "it ends with status 0 within 3 s of a shutdown",
    flood_is_read: "it returns 2000 heartbeats that are sent at once",
    output_is_bounded: "it writes at most 100 lines a second during a goal",
    output_is_messages: "every line that it writes is a message",
}

async fn hello_is_the_first_line(trial: &Trial) -> Result<(), CaseFailure> {
    let (probe, _) = Probe::ready(trial).await?;
    match (probe.line_count, &probe.first_wrong_line) {
        (1, _) => Ok(()),
        (count, Some(line)) => failed(format!("the hello is line {count}; before it is {line}")),
        (count, None) => failed(format!("the hello is line {count}")),
    }
}

async fn hello_is_accepted(trial: &Trial) -> Result<(), CaseFailure> {
    let (_probe, hello) = Probe::ready(trial).await?;
    check_hello(&trial.contract, &hello)
}

async fn pose_is_reported(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    let find = |message: &DriverMessage| matches!(message, DriverMessage::Pose { .. }).then_some(());
    probe.wait_for("pose", REPORT_LIMIT, find).await
}

async fn charge_is_reported(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    let find = |message: &DriverMessage| matches!(message, DriverMessage::Charge { .. }).then_some(());
    probe.wait_for("charge", REPORT_LIMIT, find).await
}

async fn readings_are_declared(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    let mut wrong = None;
    let mut find = |message: &DriverMessage| {
        if let DriverMessage::Readings { values } = message {
            let mut checked = values.iter().map(|(name, value)| trial.contract.accept_reading(name, value));
            wrong = wrong.take().or_else(|| checked.find_map(Result::err));
        }
        matches!(message, DriverMessage::Result { id: GoalId(1), .. }).then_some(())
    };
    probe.follow(1, "result", GOAL_LIMIT, &mut find).await?;
    match wrong {
        Some(problem) => failed(problem.to_string()),
        None => Ok(()),
    }
}

async fn heartbeat_is_answered(trial: &Trial) -> Result<(), CaseFailure> {
    Probe::ready(trial).await?.0.beat().await
}

async fn heartbeats_are_answered_in_order(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    for sequence in 1..=10 {
        probe.send(&NodeMessage::Heartbeat { sequence }).await?;
    }
    for sequence in 1..=10 {
        probe.reply(sequence, REPLY_LIMIT).await?;
    }
    Ok(())
}

async fn heartbeat_is_answered_during_a_goal(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    probe.beat().await?;
    probe.beat().await
}

async fn bad_json_is_reported(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    probe.write(b"{\"type\": \"goal\", \n").await?;
    let find = |message: &DriverMessage| matches!(message, DriverMessage::Error { .. }).then_some(());
    probe.wait_for("error", REPLY_LIMIT, find).await?;
    probe.beat().await
}

/// Checks that the driver continues after these bytes.
async fn survives(trial: &Trial, bytes: &[u8]) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    probe.write(bytes).await?;
    probe.beat().await
}

async fn unknown_message_is_ignored(trial: &Trial) -> Result<(), CaseFailure> {
    survives(trial, b"{\"type\":\"message_of_a_later_version\",\"x\":1}\n").await
}

async fn unknown_field_is_ignored(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    probe.write(b"{\"type\":\"heartbeat\",\"sequence\":7,\"field_of_a_later_version\":true}\n").await?;
    probe.reply(7, REPLY_LIMIT).await
}

async fn empty_line_is_ignored(trial: &Trial) -> Result<(), CaseFailure> {
    survives(trial, b"\n \n").await
}

async fn long_line_is_read(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    let padding = " ".repeat(60_000);
    probe.write(format!("{{\"type\":\"heartbeat\",{padding}\"sequence\":7}}\n").as_bytes()).await?;
    probe.reply(7, REPLY_LIMIT).await
}

async fn invalid_utf8_is_survived(trial: &Trial) -> Result<(), CaseFailure> {
    survives(trial, b"{\"type\":\"\xff\xfe\"}\n").await
}

async fn split_line_is_joined(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    probe.write(b"{\"type\":\"heartbe").await?;
    probe.observe(Duration::from_millis(200)).await?;
    probe.write(b"at\",\"sequence\":7}\n").await?;
    probe.reply(7, REPLY_LIMIT).await
}

async fn joined_lines_are_split(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    probe.write(b"{\"type\":\"heartbeat\",\"sequence\":7}\n{\"type\":\"heartbeat\",\"sequence\":8}\n").await?;
    probe.reply(7, REPLY_LIMIT).await?;
    probe.reply(8, REPLY_LIMIT).await
}

async fn unknown_action_is_rejected(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    let action = ActionName::new("no_such_action").expect("a name");
    probe.start_goal(1, &SampleGoal { action, parameters: JsonObject::new() }).await?;
    expect(probe.result(1, REPLY_LIMIT).await?, ResultStatus::Aborted)?;
    probe.beat().await
}

async fn wrong_parameters_are_survived(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    let parameters = goal.parameters.keys().map(|name| (name.clone(), serde_json::json!([{ "wrong": true }])));
    let wrong = SampleGoal { parameters: parameters.collect(), ..goal };
    probe.start_goal(1, &wrong).await?;
    probe.beat().await
}

fn expect(status: ResultStatus, expected: ResultStatus) -> Result<(), CaseFailure> {
    if status == expected {
        return Ok(());
    }
    failed(format!("the goal has ended as {}, not as {}", word(status), word(expected)))
}

async fn goal_succeeds(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    expect(probe.follow_to_end(1).await?, ResultStatus::Succeeded)
}

async fn goal_returns_its_results(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, hello) = Probe::ready(trial).await?;
    let goal = sample(trial, &hello)?;
    probe.start_goal(1, &goal).await?;
    expect(probe.follow_to_end(1).await?, ResultStatus::Succeeded)?;
    let values = probe.results.iter().find(|(id, ..)| id.0 == 1).map(|(.., values)| values.clone()).unwrap_or_default();
    for (name, form) in trial.contract.results(&goal.action) {
        match values.get(name) {
            None => return failed(format!("the result `{name}` is missing")),
            Some(value) if !form.kind.fits(value) => {
                let kind = serde_json::to_value(form.kind).unwrap_or_default();
                return failed(format!("the result `{name}` is {value}; the domain declares {kind}"));
            }
            Some(_) => {}
        }
    }
    Ok(())
}

async fn goal_sends_feedback(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    let find = |message: &DriverMessage| match message {
        DriverMessage::Feedback { id, .. } if id.0 == 1 => Some(true),
        DriverMessage::Result { id, .. } if id.0 == 1 => Some(false),
        _ => None,
    };
    match probe.follow(1, "feedback", GOAL_LIMIT, find).await? {
        true => Ok(()),
        false => failed("the goal has ended without feedback"),
    }
}

async fn feedback_is_declared(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    let mut wrong = None;
    let mut find = |message: &DriverMessage| {
        if let DriverMessage::Feedback { values, .. } = message {
            let (_, problems) = trial.contract.accept_feedback(&goal.action, values);
            wrong = wrong.take().or_else(|| problems.into_iter().next());
        }
        matches!(message, DriverMessage::Result { id: GoalId(1), .. }).then_some(())
    };
    probe.follow(1, "result", GOAL_LIMIT, &mut find).await?;
    match wrong {
        Some(problem) => failed(problem.to_string()),
        None => Ok(()),
    }
}

/// Checks the number of results of goal 1 after a while.
async fn expect_results(probe: &mut Probe, count: usize) -> Result<(), CaseFailure> {
    probe.observe(Duration::from_millis(500)).await?;
    let results = probe.results.iter().filter(|(id, ..)| id.0 == 1).count();
    if results == count { Ok(()) } else { failed(format!("{results} results of the same goal, not {count}")) }
}

async fn goal_has_a_single_result(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    probe.follow_to_end(1).await?;
    expect_results(&mut probe, 1).await
}

async fn next_goal_succeeds(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    for id in [1, 2] {
        probe.start_goal(id, &goal).await?;
        expect(probe.follow_to_end(id).await?, ResultStatus::Succeeded)?;
    }
    Ok(())
}

async fn repeated_goal_starts_nothing(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    probe.is_started(1).await?;
    probe.start_goal(1, &goal).await?;
    expect(probe.follow_to_end(1).await?, ResultStatus::Succeeded)?;
    expect_results(&mut probe, 1).await
}

async fn ended_goal_is_not_repeated(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    let status = probe.follow_to_end(1).await?;
    probe.start_goal(1, &goal).await?;
    let deadline = Instant::now() + Duration::from_secs(1);
    let find = |message: &DriverMessage| match message {
        DriverMessage::Feedback { id, .. } if id.0 == 1 => Some("feedback of an ended goal"),
        DriverMessage::Result { id, status: again, .. } if id.0 == 1 && *again != status => Some("another result"),
        _ => None,
    };
    let left = deadline.saturating_duration_since(Instant::now());
    match probe.wait_for("repetition", left, find).await {
        Ok(what) => failed(format!("the goal is executed again: {what}")),
        // The same result, or nothing.
        Err(_) => probe.beat().await,
    }
}

async fn cancel_stops_the_goal(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    probe.is_started(1).await?;
    // The driver must not end the goal because of its deadline.
    probe.keep(1, 10_000).await?;
    probe.cancel(1).await?;
    let limit = trial.contract.cancel_limit(&goal.action).unwrap_or(REPLY_LIMIT);
    expect(probe.result(1, limit).await?, ResultStatus::Canceled)
}

async fn repeated_cancel_is_ignored(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    probe.cancel(1).await?;
    probe.result(1, GOAL_LIMIT).await?;
    probe.cancel(1).await?;
    expect_results(&mut probe, 1).await?;
    probe.beat().await
}

async fn cancel_of_an_unknown_goal_is_ignored(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    probe.cancel(1).await?;
    expect_results(&mut probe, 0).await?;
    probe.beat().await
}

async fn deadline_stops_the_goal(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.send_goal(1, &goal, 400, false).await?;
    // A driver that ignores its permission ends the goal by itself, as succeeded.
    expect(probe.result(1, GOAL_LIMIT).await?, ResultStatus::Canceled)
}

async fn keep_extends_the_deadline(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.send_goal(1, &goal, 600, false).await?;
    expect(probe.follow_to_end(1).await?, ResultStatus::Succeeded)
}

async fn keep_of_an_ended_goal_is_ignored(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    probe.cancel(1).await?;
    probe.result(1, GOAL_LIMIT).await?;
    probe.keep(1, 1_000).await?;
    expect_results(&mut probe, 1).await?;
    probe.beat().await
}

async fn goal_without_permission_is_not_executed(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.send_goal(1, &goal, 0, false).await?;
    expect(probe.result(1, GOAL_LIMIT).await?, ResultStatus::Canceled)
}

async fn goal_is_answered_after_a_restart(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    probe.is_started(1).await?;
    probe.kill();
    drop(probe);
    let (mut probe, hello) = Probe::ready(trial).await?;
    if !hello.resumes {
        // The node ends the goal, and sends the next goal.
        probe.start_goal(2, &sample(trial, &hello)?).await?;
        return expect(probe.follow_to_end(2).await?, ResultStatus::Succeeded);
    }
    probe.send_goal(1, &goal, 1_500, true).await?;
    match probe.follow_to_end(1).await? {
        ResultStatus::Succeeded | ResultStatus::Aborted => Ok(()),
        ResultStatus::Canceled => failed("the resumed goal has ended as canceled, without a cancel"),
    }
}

async fn end_of_input_ends_the_process(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    probe.close_input();
    probe.exit(EXIT_LIMIT).await.map(drop)
}

async fn end_of_input_during_a_goal_ends_the_process(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.start_goal(1, &goal).await?;
    probe.is_started(1).await?;
    probe.close_input();
    probe.exit(EXIT_LIMIT).await.map(drop)
}

async fn shutdown_ends_the_process(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    probe.send(&NodeMessage::Shutdown {}).await?;
    match probe.exit(EXIT_LIMIT).await? {
        status if status.success() => Ok(()),
        status => failed(format!("the process has ended with {status}")),
    }
}

async fn flood_is_read(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, _) = Probe::ready(trial).await?;
    for sequence in 1..=FLOOD {
        probe.send(&NodeMessage::Heartbeat { sequence }).await?;
    }
    for sequence in 1..=FLOOD {
        probe.reply(sequence, Duration::from_secs(10)).await?;
    }
    Ok(())
}

async fn output_is_bounded(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    let (before, started) = (probe.line_count, Instant::now());
    probe.start_goal(1, &goal).await?;
    probe.follow_to_end(1).await?;
    probe.observe(Duration::from_secs(1)).await?;
    let (lines, time) = (probe.line_count - before, started.elapsed());
    if lines as f64 <= LINES_PER_S_MAX * time.as_secs_f64() {
        return Ok(());
    }
    failed(format!("{lines} lines in {:.1} s; allowed: {LINES_PER_S_MAX} a second", time.as_secs_f64()))
}

async fn output_is_messages(trial: &Trial) -> Result<(), CaseFailure> {
    let (mut probe, goal) = Probe::with_sample(trial).await?;
    probe.beat().await?;
    for id in [1, 2] {
        probe.start_goal(id, &goal).await?;
        if id == 2 {
            probe.cancel(id).await?;
        }
        probe.follow_to_end(id).await?;
    }
    probe.observe(Duration::from_secs(1)).await?;
    match &probe.first_wrong_line {
        Some(line) => failed(format!("a line is no message: {line}")),
        None => Ok(()),
    }
}
