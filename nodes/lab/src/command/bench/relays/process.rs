//! A process with sessions, on its host, as seen by the benchmark.

use super::host::{PORT, Report};
use super::{RELAYS, RobotMode};
use consort_nodes::exit::Failure;
use consort_tests::host_network::{HostNetwork, within};
use procfs_core::FromRead as _;
use procfs_core::process::{Stat, Status};
use std::fs::File;
use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// Clock ticks per second in `/proc`, on every known Linux.
const TICKS_PER_S: f64 = 100.0;

/// A process that is killed when it is dropped.
pub(super) struct HostProcess {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

fn unsuccessful(problem: impl std::fmt::Display) -> Failure {
    Failure::Unsuccessful(problem.to_string())
}

impl HostProcess {
    /// Starts a relay that is linked with the relays before it.
    pub(super) fn relay(network: &HostNetwork, host: &str, others: &[&str]) -> Result<HostProcess, Failure> {
        let mut arguments = connect(network, others);
        arguments.extend(others.is_empty().then(|| "--beacon".to_owned()));
        HostProcess::start(host, &arguments)
    }

    /// Starts robots.
    pub(super) fn robots(
        network: &HostNetwork,
        host: &str,
        first: usize,
        sessions: usize,
        mode: RobotMode,
    ) -> Result<HostProcess, Failure> {
        let mut arguments = connect(network, &RELAYS);
        for (name, value) in [("robots", sessions), ("first", first)] {
            arguments.extend([format!("--{name}"), value.to_string()]);
        }
        arguments.extend(["--mode".to_owned(), mode.name().to_owned()]);
        HostProcess::start(host, &arguments)
    }

    fn start(host: &str, arguments: &[String]) -> Result<HostProcess, Failure> {
        let program = std::env::current_exe().map_err(unsuccessful)?;
        let [ip, prefix @ ..] = within(host);
        let mut command = Command::new(ip);
        command.args(prefix).arg(program).args(["bench", "relay-host"]).args(arguments);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(unsuccessful)?;
        let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(unsuccessful("a process without pipes"));
        };
        Ok(HostProcess { child, input, output: BufReader::new(output) })
    }

    /// Returns the report on the time since the report before.
    pub(super) fn report(&mut self) -> Result<Report, Failure> {
        let mut line = String::new();
        writeln!(self.input).map_err(unsuccessful)?;
        self.output.read_line(&mut line).map_err(unsuccessful)?;
        serde_json::from_str(&line).map_err(|problem| unsuccessful(format_args!("no report ({line:?}): {problem}")))
    }

    /// Returns the computing time in seconds.
    pub(super) fn cpu_s(&self) -> f64 {
        let stat = self.file("stat").and_then(|file| Stat::from_read(file).ok());
        stat.map_or(0.0, |stat| (stat.utime + stat.stime) as f64 / TICKS_PER_S)
    }

    /// Returns the memory in MB.
    pub(super) fn memory_mb(&self) -> f64 {
        let status = self.file("status").and_then(|file| Status::from_read(file).ok());
        status.and_then(|status| status.vmrss).map_or(0.0, |kibibytes| kibibytes as f64 * 1.024 / 1000.0)
    }

    fn file(&self, name: &str) -> Option<File> {
        File::open(format!("/proc/{}/{name}", self.child.id())).ok()
    }
}

impl Drop for HostProcess {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn connect(network: &HostNetwork, relays: &[&str]) -> Vec<String> {
    let address = |relay: &&str| format!("tcp/{}:{PORT}", network.address(relay, ""));
    relays.iter().flat_map(|relay| ["--connect".to_owned(), address(relay)]).collect()
}
