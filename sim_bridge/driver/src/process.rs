//! The process of a driver, or the connection to it, from its start to its end.

use crate::endpoint::{DriverEndpoint, SocketReader, SocketWriter};
use crate::line::{LINE_BYTES_MAX, ReadLine, next_line};
use crate::messages::{DriverMessage, NodeMessage};
use crate::program::RunningDriver;
use crate::session::SessionEvent;
use crate::throttle::Throttle;
use consort_protocol::ids::RobotId;
use futures::FutureExt as _;
use futures::future::Shared;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt as _, BufReader};
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::mpsc::{Receiver, Sender, UnboundedReceiver, UnboundedSender, channel, unbounded_channel};
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout};
use tracing::info;

/// Number of events that wait for the session. The reader then stops reading, and the driver
/// blocks.
const EVENTS_MAX: usize = 256;

/// Number of messages that wait for a driver that does not read; then it is killed.
const MESSAGES_MAX: usize = 256;

/// Time for a process to end after a shutdown message, until it is killed.
const SHUTDOWN_LIMIT: Duration = Duration::from_secs(3);

/// Time for the last lines of a process that has ended, and for the end of a process after its last
/// line.
const DRAIN_LIMIT: Duration = Duration::from_millis(500);

/// A command for the process.
pub(crate) enum ProcessCommand {
    Spawn,
    Send(NodeMessage),
    Kill(String),
}

/// Handle of the task that runs the process or the connection, which ends when this is dropped.
pub(crate) struct DriverProcess {
    pub(crate) commands: UnboundedSender<ProcessCommand>,
    pub(crate) events: Receiver<SessionEvent>,
}

impl DriverProcess {
    /// Starts the task, within a runtime; the process starts with [`ProcessCommand::Spawn`].
    pub(crate) fn start(robot: RobotId, endpoint: DriverEndpoint) -> DriverProcess {
        let ((commands, receiver), (sender, events)) = (unbounded_channel(), channel(EVENTS_MAX));
        tokio::spawn(supervise(robot, endpoint, receiver, sender));
        DriverProcess { commands, events }
    }
}

/// Runs the processes of a driver, or the connections to it, in sequence.
async fn supervise(
    robot: RobotId,
    endpoint: DriverEndpoint,
    mut commands: UnboundedReceiver<ProcessCommand>,
    events: Sender<SessionEvent>,
) {
    while let Some(command) = commands.recv().await {
        // Messages to a process that has ended are dropped.
        let ProcessCommand::Spawn = command else { continue };
        let mut tasks = JoinSet::new();
        let started = match &endpoint {
            DriverEndpoint::Program(program) => match program.spawn() {
                Ok(mut running) => {
                    let (stdin, stdout, stderr) = running.take_streams();
                    tasks.spawn(log_errors(robot.clone(), stderr));
                    Ok((
                        LiveDriver::Process(running),
                        Box::new(stdin) as SocketWriter,
                        Box::new(stdout) as SocketReader,
                    ))
                }
                Err(problem) => Err(format!("{program} cannot be started: {problem}")),
            },
            DriverEndpoint::Socket(socket) => match socket.connect().await {
                Ok((reader, writer)) => Ok((LiveDriver::Connection, writer, reader)),
                Err(problem) => Err(format!("no connection to {socket}: {problem}")),
            },
        };
        let how = match started {
            Ok((driver, input, output)) => run(driver, input, output, tasks, &mut commands, &events).await,
            Err(problem) => problem,
        };
        if events.send(SessionEvent::Ended(how)).await.is_err() {
            return;
        }
    }
}

/// A driver with which messages are exchanged.
enum LiveDriver {
    Process(RunningDriver),
    Connection,
}

/// Ends when the output of a driver has been read to its end.
type OutputEnd = Shared<oneshot::Receiver<()>>;

impl LiveDriver {
    /// Waits for the end of the process or of the connection, and returns how it ended.
    async fn wait(&mut self, output_end: OutputEnd) -> String {
        match self {
            LiveDriver::Process(running) => match running.wait().await {
                Ok(status) => status.to_string(),
                Err(problem) => format!("its end is unknown: {problem}"),
            },
            LiveDriver::Connection => {
                let _ = output_end.await;
                "it closed the connection".to_owned()
            }
        }
    }

    /// Kills the process, or closes the connection, which ends with the tasks that use it.
    fn stop(&self, tasks: &mut JoinSet<()>) {
        match self {
            LiveDriver::Process(running) => running.kill(),
            LiveDriver::Connection => tasks.abort_all(),
        }
    }
}

/// Exchanges messages with a driver to its end, and returns how it ended.
async fn run(
    mut driver: LiveDriver,
    input: SocketWriter,
    output: SocketReader,
    mut tasks: JoinSet<()>,
    commands: &mut UnboundedReceiver<ProcessCommand>,
    events: &Sender<SessionEvent>,
) -> String {
    let (messages, queued) = channel(MESSAGES_MAX);
    let mut messages = Some(messages);
    let (output_closed, output_end) = oneshot::channel();
    let output_end = output_end.shared();
    // All tasks end with this function.
    tasks.spawn(write_messages(input, queued));
    let reading = read_messages(output, events.clone());
    tasks.spawn(reading.map(|()| drop(output_closed)));
    let mut stopped: Option<String> = None;
    let ended = loop {
        let is_open_process = matches!(driver, LiveDriver::Process(_)) && output_end.peek().is_none();
        tokio::select! {
            end = driver.wait(output_end.clone()) => break end,
            _ = output_end.clone(), if is_open_process => {
                // Usually the process ends at the same time.
                if let Ok(end) = timeout(DRAIN_LIMIT, driver.wait(output_end.clone())).await {
                    break end;
                }
                stopped.get_or_insert_with(|| "it closed its standard output".to_owned());
                driver.stop(&mut tasks);
            }
            command = commands.recv(), if messages.is_some() => match command {
                Some(ProcessCommand::Send(message)) => {
                    let sent = messages.as_ref().map(|messages| messages.try_send(message.to_line()));
                    if let Some(Err(TrySendError::Full(_))) = sent {
                        stopped.get_or_insert_with(|| format!("it has not read {MESSAGES_MAX} messages"));
                        driver.stop(&mut tasks);
                    }
                }
                Some(ProcessCommand::Kill(reason)) => {
                    stopped.get_or_insert(reason);
                    driver.stop(&mut tasks);
                }
                Some(ProcessCommand::Spawn) => {} // a session spawns only after the end
                // The node ends.
                None => {
                    if let Some(messages) = messages.take() {
                        let _ = messages.try_send(NodeMessage::Shutdown {}.to_line());
                    }
                    if timeout(SHUTDOWN_LIMIT, driver.wait(output_end.clone())).await.is_err() {
                        driver.stop(&mut tasks);
                    }
                }
            },
        }
    };
    // Descendants that keep the streams open end, too.
    driver.stop(&mut tasks);
    let _ = timeout(DRAIN_LIMIT, output_end).await;
    match (stopped, driver) {
        (Some(reason), LiveDriver::Process(_)) => format!("killed: {reason}"),
        (Some(reason), LiveDriver::Connection) => format!("disconnected: {reason}"),
        (None, _) => ended,
    }
}

/// Writes messages until the driver closes its input, or the sender is dropped.
async fn write_messages(mut input: impl AsyncWrite + Unpin, mut messages: Receiver<String>) {
    while let Some(line) = messages.recv().await {
        if input.write_all(line.as_bytes()).await.is_err() {
            // The end of the driver is reported by the wait for it.
            return;
        }
    }
}

/// Reads messages to the end of the stream, at the rate of the throttle.
async fn read_messages(stdout: impl AsyncRead + Unpin, events: Sender<SessionEvent>) {
    let (mut reader, mut throttle, started) = (BufReader::new(stdout), Throttle::new(), Instant::now());
    let mut is_reported = false;
    loop {
        let event = match next_line(&mut reader).await {
            ReadLine::End => return,
            ReadLine::Text(line) if line.trim().is_empty() => continue,
            ReadLine::Text(line) => match DriverMessage::parse(&line) {
                Ok(message) => SessionEvent::Message(message),
                Err(problem) => SessionEvent::WrongLine(format!("{problem}: {}", consort_text::shorten(&line, 200))),
            },
            ReadLine::TooLong => {
                SessionEvent::WrongLine(format!("a line has more than {LINE_BYTES_MAX} bytes and is skipped"))
            }
        };
        if events.send(event).await.is_err() {
            return;
        }
        let wait = throttle.take(started.elapsed());
        if !wait.is_zero() {
            if !std::mem::replace(&mut is_reported, true) && events.send(SessionEvent::Throttled).await.is_err() {
                return;
            }
            sleep(wait).await;
        }
    }
}

/// Forwards the lines of the standard error to the log, at the rate of the throttle.
async fn log_errors(robot: RobotId, stderr: impl AsyncRead + Unpin) {
    let (mut reader, mut throttle, started) = (BufReader::new(stderr), Throttle::new(), Instant::now());
    loop {
        match next_line(&mut reader).await {
            ReadLine::End => return,
            ReadLine::Text(line) => info!(%robot, line = %consort_text::shorten(&line, 1000), "driver"),
            ReadLine::TooLong => info!(%robot, "a line of the driver's standard error is too long"),
        }
        sleep(throttle.take(started.elapsed())).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::DriverProgram;

    /// Collects the events of a shell script that runs as a driver, up to its end.
    async fn run_script(script: &str, commands: Vec<ProcessCommand>) -> Vec<SessionEvent> {
        let program = DriverProgram::new(["sh", "-c", script].map(str::to_owned).to_vec()).unwrap();
        let mut process = DriverProcess::start("ada".parse().unwrap(), program.into());
        process.commands.send(ProcessCommand::Spawn).unwrap();
        for command in commands {
            process.commands.send(command).unwrap();
        }
        let mut events = vec![];
        loop {
            let event = timeout(Duration::from_secs(60), process.events.recv()).await.expect("in time");
            let event = event.expect("a process ends with an event");
            let is_end = matches!(event, SessionEvent::Ended(_));
            events.push(event);
            if is_end {
                return events;
            }
        }
    }

    #[tokio::test]
    async fn lines_of_a_process_become_events_and_its_end_is_the_last() {
        let script = r#"read line; echo '{"type":"heartbeat","sequence":4}'; echo; echo nonsense; exit 3"#;
        let beat = NodeMessage::Heartbeat { sequence: 4 };
        let events = run_script(script, vec![ProcessCommand::Send(beat)]).await;
        assert_eq!(events[0], SessionEvent::Message(DriverMessage::Heartbeat { sequence: 4 }));
        assert!(matches!(&events[1], SessionEvent::WrongLine(line) if line.ends_with(": nonsense")), "{events:?}");
        assert_eq!(events[2..], [SessionEvent::Ended("exit status: 3".to_owned())]);
    }

    #[tokio::test]
    async fn a_killed_process_ends_with_its_descendants() {
        let kill = ProcessCommand::Kill("of a test".to_owned());
        // The background process keeps the output open.
        let events = run_script("sleep 1000 & sleep 1000", vec![kill]).await;
        assert_eq!(events, [SessionEvent::Ended("killed: of a test".to_owned())]);
    }

    #[tokio::test]
    async fn a_flood_is_throttled_once_and_read_completely() {
        let events = run_script("i=0; while [ $i -lt 500 ]; do echo x; i=$((i+1)); done", vec![]).await;
        let throttled = events.iter().filter(|event| **event == SessionEvent::Throttled).count();
        assert_eq!((events.len(), throttled), (502, 1));
    }

    #[tokio::test]
    async fn a_missing_program_is_an_end() {
        let program = DriverProgram::new(vec!["/no/such/program".to_owned()]).unwrap();
        let mut process = DriverProcess::start("ada".parse().unwrap(), program.into());
        process.commands.send(ProcessCommand::Spawn).unwrap();
        let Some(SessionEvent::Ended(how)) = process.events.recv().await else { panic!("no end") };
        assert!(how.starts_with("\"/no/such/program\" cannot be started: "), "{how}");
    }
}
