//! A process of the checked driver, or a connection to it, and what it has written so far.

use super::{CaseFailure, SampleGoal, Trial};
use crate::contract::Contract;
use crate::endpoint::{DriverEndpoint, SocketReader, SocketWriter};
use crate::line::{ReadLine, next_line};
use crate::messages::{DriverMessage, NodeMessage, OfferedAction, PROTOCOL_VERSION, ResultStatus};
use crate::program::RunningDriver;
use consort_protocol::ids::{ActionName, PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_skills::actions::{GoalId, JsonObject};
use serde_json::json;
use std::collections::BTreeMap;
use std::process::ExitStatus;
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::sync::mpsc::{Receiver, channel};
use tokio::task::JoinSet;
use tokio::time::{Instant, timeout, timeout_at};

/// Limit for a hello.
const HELLO_LIMIT: Duration = Duration::from_secs(10);

/// Limit for the reply to a heartbeat, and for the effect of a cancel or of the end of a
/// permission.
pub(super) const REPLY_LIMIT: Duration = Duration::from_secs(2);

/// Limit for a whole sample goal.
pub(super) const GOAL_LIMIT: Duration = Duration::from_secs(60);

/// Permission of a goal that is renewed.
const KEEP_FOR_MS: u64 = 1_500;

/// Interval of renewals.
const KEEP_INTERVAL: Duration = Duration::from_millis(300);

/// Lines that wait for the case. Then the reader stops, and the driver blocks.
const LINES_MAX: usize = 1 << 16;

/// Content of a hello.
#[derive(Debug, Clone)]
pub(super) struct Hello {
    pub(super) protocol: u32,
    pub(super) actions: BTreeMap<ActionName, OfferedAction>,
    pub(super) resumes: bool,
}

/// See the [module](self).
pub(super) struct Probe {
    /// `None` for a connection.
    process: Option<RunningDriver>,
    input: Option<SocketWriter>,
    /// Readers of the streams. Their end closes a connection.
    readers: JoinSet<()>,
    lines: Receiver<String>,
    /// Number of lines received.
    pub(super) line_count: usize,
    /// The first line that is no message, with the problem.
    pub(super) first_wrong_line: Option<String>,
    /// Results received, in order.
    pub(super) results: Vec<(GoalId, ResultStatus, JsonObject)>,
    sequence: u64,
    /// The cases number their goals from 1; the ids that the driver gets are greater by this number.
    goals_after: u64,
}

pub(super) fn failed<T>(what: impl Into<String>) -> Result<T, CaseFailure> {
    Err(CaseFailure(what.into()))
}

impl Probe {
    /// Starts the driver, with its start message.
    pub(super) async fn start(trial: &Trial) -> Result<Probe, CaseFailure> {
        let mut readers = JoinSet::new();
        let (process, input, output) = match &trial.endpoint {
            DriverEndpoint::Program(program) => {
                let spawned = program.spawn();
                let mut running =
                    spawned.map_err(|problem| CaseFailure(format!("the driver cannot be started: {problem}")))?;
                let (stdin, stdout, mut stderr) = running.take_streams();
                readers.spawn(async move {
                    let mut sink = [0; 4096];
                    while stderr.read(&mut sink).await.is_ok_and(|read| read > 0) {}
                });
                (Some(running), Box::new(stdin) as SocketWriter, Box::new(stdout) as SocketReader)
            }
            DriverEndpoint::Socket(socket) => {
                let connected = socket.connect().await;
                let (output, input) =
                    connected.map_err(|problem| CaseFailure(format!("no connection to {socket}: {problem}")))?;
                (None, input, output)
            }
        };
        let (sender, lines) = channel(LINES_MAX);
        readers.spawn(async move {
            let mut reader = BufReader::new(output);
            loop {
                let line = match next_line(&mut reader).await {
                    ReadLine::End => return,
                    ReadLine::Text(line) => line,
                    ReadLine::TooLong => "a line that is too long".to_owned(),
                };
                if sender.send(line).await.is_err() {
                    return;
                }
            }
        });
        let mut probe = Probe {
            process,
            input: Some(input),
            readers,
            lines,
            line_count: 0,
            first_wrong_line: None,
            results: vec![],
            sequence: 0,
            goals_after: trial.goals_after,
        };
        let robot = RobotId::new("check").expect("a name");
        let place = PlaceId::new("Dock").expect("a name");
        probe.send(&NodeMessage::Start { protocol: PROTOCOL_VERSION, robot, place, pose: Pose::default() }).await?;
        Ok(probe)
    }

    /// Starts the driver, and waits for its hello.
    pub(super) async fn ready(trial: &Trial) -> Result<(Probe, Hello), CaseFailure> {
        let mut probe = Probe::start(trial).await?;
        let hello = probe.hello().await?;
        Ok((probe, hello))
    }

    /// Starts the driver, and returns the goal to try.
    pub(super) async fn with_sample(trial: &Trial) -> Result<(Probe, SampleGoal), CaseFailure> {
        let (probe, hello) = Probe::ready(trial).await?;
        Ok((probe, sample(trial, &hello)?))
    }

    pub(super) async fn hello(&mut self) -> Result<Hello, CaseFailure> {
        self.wait_for("hello", HELLO_LIMIT, |message| match message {
            DriverMessage::Hello { protocol, actions, resumes, .. } => {
                Some(Hello { protocol: *protocol, actions: actions.clone(), resumes: *resumes })
            }
            _ => None,
        })
        .await
    }

    /// Writes bytes to the driver.
    pub(super) async fn write(&mut self, bytes: &[u8]) -> Result<(), CaseFailure> {
        let Some(input) = &mut self.input else { return failed("its input is closed") };
        // A write to a connection may wait in a buffer.
        let write = async {
            input.write_all(bytes).await?;
            input.flush().await
        };
        match timeout(GOAL_LIMIT, write).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) => failed(self.end_text("it does not read its input").await),
            Err(_) => failed("it does not read its input"),
        }
    }

    pub(super) async fn send(&mut self, message: &NodeMessage) -> Result<(), CaseFailure> {
        self.write(message.to_line().as_bytes()).await
    }

    fn goal_id(&self, number: u64) -> GoalId {
        GoalId(self.goals_after + number)
    }

    pub(super) async fn send_goal(
        &mut self,
        id: u64,
        goal: &SampleGoal,
        keep_for_ms: u64,
        resumed: bool,
    ) -> Result<(), CaseFailure> {
        let SampleGoal { action, parameters } = goal.clone();
        let id = self.goal_id(id);
        self.send(&NodeMessage::Goal { id, action, parameters, keep_for_ms, resumed, since: None }).await
    }

    /// Starts the sample goal with a permission that [`follow`](Probe::follow) renews.
    pub(super) async fn start_goal(&mut self, id: u64, goal: &SampleGoal) -> Result<(), CaseFailure> {
        self.send_goal(id, goal, KEEP_FOR_MS, false).await
    }

    pub(super) async fn cancel(&mut self, id: u64) -> Result<(), CaseFailure> {
        self.send(&NodeMessage::Cancel { id: self.goal_id(id) }).await
    }

    pub(super) async fn keep(&mut self, id: u64, keep_for_ms: u64) -> Result<(), CaseFailure> {
        self.send(&NodeMessage::Keep { id: self.goal_id(id), keep_for_ms }).await
    }

    /// Closes the input of the driver.
    pub(super) fn close_input(&mut self) {
        self.input = None;
    }

    /// Kills the process, or closes the connection.
    pub(super) fn kill(&mut self) {
        self.close_input();
        match &self.process {
            Some(running) => running.kill(),
            None => self.readers.abort_all(),
        }
    }

    /// Waits for the end of the process.
    pub(super) async fn exit(&mut self, limit: Duration) -> Result<ExitStatus, CaseFailure> {
        let Some(running) = &mut self.process else { return failed("it is no process") };
        match timeout(limit, running.wait()).await {
            Ok(Ok(status)) => Ok(status),
            Ok(Err(problem)) => failed(format!("the end of the process is unknown: {problem}")),
            Err(_) => failed(format!("the process has not ended within {limit:?}")),
        }
    }

    async fn end_text(&mut self, otherwise: &str) -> String {
        match self.exit(Duration::from_millis(500)).await {
            Ok(status) => format!("the process has ended ({status})"),
            Err(_) => otherwise.to_owned(), // also of a connection
        }
    }

    /// Returns the next message until `deadline`; `None` at the deadline. Wrong lines are recorded.
    async fn next(&mut self, deadline: Instant) -> Result<Option<DriverMessage>, CaseFailure> {
        loop {
            let line = match timeout_at(deadline, self.lines.recv()).await {
                Err(_) => return Ok(None),
                Ok(None) => return failed(self.end_text("it has closed its output").await),
                Ok(Some(line)) => line,
            };
            self.line_count += 1;
            match DriverMessage::parse(&line) {
                Ok(mut message) => {
                    if let DriverMessage::Feedback { id, .. } | DriverMessage::Result { id, .. } = &mut message {
                        *id = GoalId(id.0.wrapping_sub(self.goals_after));
                    }
                    if let DriverMessage::Result { id, status, results, .. } = &message {
                        self.results.push((*id, *status, results.clone()));
                    }
                    return Ok(Some(message));
                }
                Err(problem) => {
                    let shown = consort_text::shorten(&line, 80);
                    self.first_wrong_line.get_or_insert_with(|| format!("{shown:?}: {problem}"));
                }
            }
        }
    }

    /// Waits for the first matching message.
    pub(super) async fn wait_for<T>(
        &mut self,
        what: &str,
        limit: Duration,
        mut find: impl FnMut(&DriverMessage) -> Option<T>,
    ) -> Result<T, CaseFailure> {
        let deadline = Instant::now() + limit;
        while let Some(message) = self.next(deadline).await? {
            if let Some(found) = find(&message) {
                return Ok(found);
            }
        }
        let of_wrong = self.first_wrong_line.as_ref().map(|line| format!("; a line is no message: {line}"));
        failed(format!("no {what} within {limit:?}{}", of_wrong.unwrap_or_default()))
    }

    /// Receives messages for a time.
    pub(super) async fn observe(&mut self, time: Duration) -> Result<(), CaseFailure> {
        let deadline = Instant::now() + time;
        while self.next(deadline).await?.is_some() {}
        Ok(())
    }

    /// Waits for the first matching message, and renews the permission of a goal meanwhile.
    pub(super) async fn follow<T>(
        &mut self,
        id: u64,
        what: &str,
        limit: Duration,
        mut find: impl FnMut(&DriverMessage) -> Option<T>,
    ) -> Result<T, CaseFailure> {
        let deadline = Instant::now() + limit;
        loop {
            self.keep(id, KEEP_FOR_MS).await?;
            let renewal = (Instant::now() + KEEP_INTERVAL).min(deadline);
            while let Some(message) = self.next(renewal).await? {
                if let Some(found) = find(&message) {
                    return Ok(found);
                }
            }
            if Instant::now() >= deadline {
                return failed(format!("no {what} within {limit:?}"));
            }
        }
    }

    /// Renews the permission of a goal until its result arrives.
    pub(super) async fn follow_to_end(&mut self, id: u64) -> Result<ResultStatus, CaseFailure> {
        self.follow(id, "result", GOAL_LIMIT, result_of(id)).await
    }

    /// Waits for the result of a goal, without renewals.
    pub(super) async fn result(&mut self, id: u64, limit: Duration) -> Result<ResultStatus, CaseFailure> {
        self.wait_for("result", limit, result_of(id)).await
    }

    /// Waits until the driver executes a goal: until its first feedback, at most for a short time.
    pub(super) async fn is_started(&mut self, id: u64) -> Result<(), CaseFailure> {
        let deadline = Instant::now() + Duration::from_millis(300);
        while let Some(message) = self.next(deadline).await? {
            match message {
                DriverMessage::Feedback { id: of, .. } if of.0 == id => return Ok(()),
                DriverMessage::Result { id: of, status, .. } if of.0 == id => {
                    return failed(format!("the goal has ended at once, as {}", word(status)));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Sends a heartbeat, and waits for the reply.
    pub(super) async fn beat(&mut self) -> Result<(), CaseFailure> {
        self.sequence += 1;
        let expected = self.sequence;
        self.send(&NodeMessage::Heartbeat { sequence: expected }).await?;
        self.reply(expected, REPLY_LIMIT).await
    }

    /// Waits for the reply to a heartbeat.
    pub(super) async fn reply(&mut self, expected: u64, limit: Duration) -> Result<(), CaseFailure> {
        let find = |message: &DriverMessage| match message {
            DriverMessage::Heartbeat { sequence } => Some(*sequence),
            _ => None,
        };
        match self.wait_for("reply to a heartbeat", limit, find).await? {
            sequence if sequence == expected => Ok(()),
            other => failed(format!("the reply to heartbeat {expected} has the number {other}")),
        }
    }
}

fn result_of(id: u64) -> impl FnMut(&DriverMessage) -> Option<ResultStatus> {
    move |message| match message {
        DriverMessage::Result { id: of, status, .. } if of.0 == id => Some(*status),
        _ => None,
    }
}

/// Returns the name of a status in messages.
pub(super) fn word(status: ResultStatus) -> &'static str {
    match status {
        ResultStatus::Succeeded => "succeeded",
        ResultStatus::Canceled => "canceled",
        ResultStatus::Aborted => "aborted",
    }
}

/// Returns the goal to try: the given one, the example of an offered action, or a `wait`.
pub(super) fn sample(trial: &Trial, hello: &Hello) -> Result<SampleGoal, CaseFailure> {
    if let Some(goal) = &trial.goal {
        return Ok(goal.clone());
    }
    let example = hello.actions.iter().find_map(|(action, offered)| {
        let parameters = offered.example.clone()?;
        Some(SampleGoal { action: action.clone(), parameters })
    });
    let wait = || {
        let action = hello.actions.keys().find(|action| action.as_str() == "wait")?.clone();
        Some(SampleGoal { action, parameters: JsonObject::from_iter([("time".to_owned(), json!(2.0))]) })
    };
    match example.or_else(wait) {
        Some(goal) => Ok(goal),
        None => failed("there is no goal to try: no offered action has an `example`; add one, or use --goal"),
    }
}

/// Checks a hello.
pub(super) fn check_hello(contract: &Contract, hello: &Hello) -> Result<(), CaseFailure> {
    contract.check(hello.protocol, &hello.actions).map_err(|problem| CaseFailure(problem.to_string()))
}
