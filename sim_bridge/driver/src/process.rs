//! The process of a driver: its start, its streams and its end.

use crate::line::{LINE_BYTES_MAX, ReadLine, next_line};
use crate::messages::{DriverMessage, NodeMessage};
use crate::session::SessionEvent;
use crate::throttle::Throttle;
use consort_protocol::ids::RobotId;
use rustix::process::{Pid, Signal, kill_process_group};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWriteExt as _, BufReader};
use tokio::process::{Child, ChildStdin, Command};
use tokio::sync::mpsc::{Receiver, Sender, UnboundedReceiver, UnboundedSender, channel, unbounded_channel};
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

/// Command line of a driver.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriverProgram {
    words: Vec<String>,
}

/// A driver cannot be started.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProgramError {
    /// The command line has no words.
    #[error("the list is empty; it contains a program and its arguments, as [\"python3\", \"driver.py\"]")]
    Empty,
    /// The program does not exist.
    #[error("the program {0:?} was not found; allowed is a path, or the name of a program in PATH")]
    NotFound(String),
}

impl DriverProgram {
    /// Creates a command line from its words: the program and its arguments.
    ///
    /// # Errors
    /// [`ProgramError::Empty`].
    pub fn new(words: Vec<String>) -> Result<DriverProgram, ProgramError> {
        if words.first().is_none_or(String::is_empty) { Err(ProgramError::Empty) } else { Ok(DriverProgram { words }) }
    }

    /// Replaces the words that are paths relative to `folder`: a program with a `/`, and every
    /// argument that names a file in it.
    pub fn resolve(words: &mut [String], folder: &Path) {
        for (index, word) in words.iter_mut().enumerate() {
            let is_path = if index == 0 { word.contains('/') } else { folder.join(&*word).is_file() };
            if is_path {
                *word = folder.join(&*word).components().collect::<PathBuf>().display().to_string();
            }
        }
    }

    /// Checks that the program exists.
    ///
    /// # Errors
    /// [`ProgramError::NotFound`].
    pub fn check_exists(&self) -> Result<(), ProgramError> {
        let program = Path::new(&self.words[0]);
        let path = std::env::var_os("PATH").unwrap_or_default();
        let is_found = match self.words[0].contains('/') {
            true => program.is_file(),
            false => std::env::split_paths(&path).any(|folder| folder.join(program).is_file()),
        };
        if is_found { Ok(()) } else { Err(ProgramError::NotFound(self.words[0].clone())) }
    }

    /// Starts the process in a process group of its own.
    pub(crate) fn spawn(&self) -> io::Result<RunningDriver> {
        let mut command = Command::new(&self.words[0]);
        command.args(&self.words[1..]).process_group(0).kill_on_drop(true);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let child = command.spawn()?;
        let group = child.id().and_then(|id| Pid::from_raw(i32::try_from(id).ok()?));
        Ok(RunningDriver { child, group: Group(group) })
    }
}

/// The process group of a driver, killed on drop.
struct Group(Option<Pid>);

impl Group {
    fn kill(&self) {
        if let Some(group) = self.0 {
            // Its processes may have ended already.
            let _ = kill_process_group(group, Signal::KILL);
        }
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A running process of a driver, killed with its descendants on drop.
pub(crate) struct RunningDriver {
    child: Child,
    group: Group,
}

impl RunningDriver {
    /// Takes the standard streams: input, output, error.
    pub(crate) fn take_streams(
        &mut self,
    ) -> (ChildStdin, impl AsyncRead + Unpin + use<>, impl AsyncRead + Unpin + use<>) {
        let taken = (self.child.stdin.take(), self.child.stdout.take(), self.child.stderr.take());
        let (Some(stdin), Some(stdout), Some(stderr)) = taken else { panic!("streams are piped and taken once") };
        (stdin, stdout, stderr)
    }

    /// Waits for the end of the process.
    pub(crate) async fn wait(&mut self) -> io::Result<ExitStatus> {
        self.child.wait().await
    }

    /// Kills the process and its descendants.
    pub(crate) fn kill(&self) {
        self.group.kill();
    }
}

/// A command for the process.
pub(crate) enum ProcessCommand {
    Spawn,
    Send(NodeMessage),
    Kill(String),
}

/// Connection to the task that runs the process. The process ends when it is dropped.
pub(crate) struct DriverProcess {
    pub(crate) commands: UnboundedSender<ProcessCommand>,
    pub(crate) events: Receiver<SessionEvent>,
}

impl DriverProcess {
    /// Starts the task, within a runtime; the process starts with [`ProcessCommand::Spawn`].
    pub(crate) fn start(robot: RobotId, program: DriverProgram) -> DriverProcess {
        let ((commands, receiver), (sender, events)) = (unbounded_channel(), channel(EVENTS_MAX));
        tokio::spawn(supervise(robot, program, receiver, sender));
        DriverProcess { commands, events }
    }
}

/// Runs one process after the other.
async fn supervise(
    robot: RobotId,
    program: DriverProgram,
    mut commands: UnboundedReceiver<ProcessCommand>,
    events: Sender<SessionEvent>,
) {
    while let Some(command) = commands.recv().await {
        // Messages to a process that has ended are dropped.
        let ProcessCommand::Spawn = command else { continue };
        let how = match program.spawn() {
            Ok(running) => run(&robot, running, &mut commands, &events).await,
            Err(problem) => format!("{:?} cannot be started: {problem}", program.words[0]),
        };
        if events.send(SessionEvent::Ended(how)).await.is_err() {
            return;
        }
    }
}

/// Runs a process to its end, and returns how it ended.
async fn run(
    robot: &RobotId,
    mut running: RunningDriver,
    commands: &mut UnboundedReceiver<ProcessCommand>,
    events: &Sender<SessionEvent>,
) -> String {
    let (stdin, stdout, stderr) = running.take_streams();
    let (messages, queued) = channel(MESSAGES_MAX);
    let mut messages = Some(messages);
    // All three tasks end with this function.
    let mut tasks = tokio::task::JoinSet::new();
    tasks.spawn(write_messages(stdin, queued));
    tasks.spawn(log_errors(robot.clone(), stderr));
    let mut reader = tokio::task::JoinSet::new();
    reader.spawn(read_messages(stdout, events.clone()));
    let mut killed: Option<String> = None;
    let ended = loop {
        tokio::select! {
            status = running.wait() => break status,
            _ = reader.join_next(), if !reader.is_empty() => {
                // Usually the process ends at the same time.
                if let Ok(status) = timeout(DRAIN_LIMIT, running.wait()).await {
                    break status;
                }
                killed.get_or_insert_with(|| "it closed its standard output".to_owned());
                running.kill();
            }
            command = commands.recv(), if messages.is_some() => match command {
                Some(ProcessCommand::Send(message)) => {
                    let sent = messages.as_ref().map(|messages| messages.try_send(message.to_line()));
                    if let Some(Err(tokio::sync::mpsc::error::TrySendError::Full(_))) = sent {
                        killed.get_or_insert_with(|| format!("it has not read {MESSAGES_MAX} messages"));
                        running.kill();
                    }
                }
                Some(ProcessCommand::Kill(reason)) => {
                    killed.get_or_insert(reason);
                    running.kill();
                }
                Some(ProcessCommand::Spawn) => {} // a session spawns only after the end
                // The node ends.
                None => {
                    if let Some(messages) = messages.take() {
                        let _ = messages.try_send(NodeMessage::Shutdown {}.to_line());
                    }
                    if timeout(SHUTDOWN_LIMIT, running.wait()).await.is_err() {
                        running.kill();
                    }
                }
            },
        }
    };
    // Descendants that keep the streams open end, too.
    running.kill();
    let _ = timeout(DRAIN_LIMIT, reader.join_next()).await;
    match (killed, ended) {
        (Some(reason), _) => format!("killed: {reason}"),
        (None, Ok(status)) => status.to_string(),
        (None, Err(problem)) => format!("its end is unknown: {problem}"),
    }
}

/// Writes messages until the process closes its input, or the sender is dropped.
async fn write_messages(mut stdin: ChildStdin, mut messages: Receiver<String>) {
    while let Some(line) = messages.recv().await {
        if stdin.write_all(line.as_bytes()).await.is_err() {
            // The end of the process is reported by the wait for it.
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

    #[test]
    fn paths_of_a_command_line_are_relative_to_its_file() {
        let folder = std::env::temp_dir().join(format!("consort-driver-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("driver.py"), "").unwrap();
        let resolved = |words: &[&str]| {
            let mut words: Vec<String> = words.iter().map(|word| (*word).to_owned()).collect();
            DriverProgram::resolve(&mut words, &folder);
            words
        };
        let script = folder.join("driver.py").display().to_string();
        assert_eq!(resolved(&["python3", "driver.py", "--fast"]), ["python3", &script, "--fast"]);
        assert_eq!(resolved(&["./driver.py"]), [script.as_str()]);
        assert_eq!(resolved(&["python3", &script]), ["python3", &script], "absolute");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_program_that_does_not_exist_is_reported() {
        assert_eq!(DriverProgram::new(vec![]), Err(ProgramError::Empty));
        let check = |word: &str| DriverProgram::new(vec![word.to_owned()]).unwrap().check_exists();
        assert_eq!((check("sh"), check("/bin/sh")), (Ok(()), Ok(())));
        assert_eq!(check("no-such-program"), Err(ProgramError::NotFound("no-such-program".to_owned())));
    }

    /// Collects the events of a shell script that runs as a driver, up to its end.
    async fn run_script(script: &str, commands: Vec<ProcessCommand>) -> Vec<SessionEvent> {
        let program = DriverProgram::new(["sh", "-c", script].map(str::to_owned).to_vec()).unwrap();
        let mut process = DriverProcess::start("ada".parse().unwrap(), program);
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
        let mut process = DriverProcess::start("ada".parse().unwrap(), program);
        process.commands.send(ProcessCommand::Spawn).unwrap();
        let Some(SessionEvent::Ended(how)) = process.events.recv().await else { panic!("no end") };
        assert!(how.starts_with("\"/no/such/program\" cannot be started: "), "{how}");
    }
}
