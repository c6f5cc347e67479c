//! The program of a driver: its command line, and its running process.

use rustix::process::{Pid, Signal, kill_process_group};
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use tokio::io::AsyncRead;
use tokio::process::{Child, ChildStdin, Command};

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

impl fmt::Display for DriverProgram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.words[0])
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
}
