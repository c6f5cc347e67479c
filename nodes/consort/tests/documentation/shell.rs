//! Runs a page as a reader would in a terminal: writes its files, executes its commands, and
//! compares their output.
//!
//! - ```` ```yaml ward.yaml ``` is a file of that name.
//! - ```` ```console ```` contains commands after `$ `, each followed by its output. `…` matches any
//!   text, within a line or over several lines, and the number of spaces between words is ignored.
//!   A command must succeed, unless `$ echo $?` follows with another exit code.
//! - A command that ends in `&` runs until the end of the page, or until `$ kill -9 %N` for the Nth
//!   of them. After such a command, a query command is repeated until its output matches, up to a
//!   generous limit, because nodes need time to meet.
//!
//! Ports of the page are replaced by free ports, so that pages do not interfere.

use super::binary::{command, program};
use super::free_port::free_port;
use super::page::Page;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Limit for a command to print the expected output.
const LIMIT: Duration = Duration::from_secs(90);

/// Separates the output of a substituted program from the preceding output of the test process that
/// runs it.
pub(crate) const OUTPUT_MARKER: &str = "\n== the program ==\n";

/// Programs other than `consort`: the words that name each, and a function that creates its
/// command.
pub(crate) type Programs<'a> = &'a [(&'a str, fn(&[String]) -> Command)];

/// A command and its expected output.
#[derive(Debug, PartialEq, Eq)]
struct PageStep {
    line: usize,
    command: String,
    expected_output: Vec<String>,
}

/// Runs a page in its own folder, which keeps the files.
///
/// # Panics
/// If a command does not match the page. The message contains the line of the page.
pub(crate) fn run_page(page: &Page, programs: Programs<'_>) -> PathBuf {
    let name = page.path.file_stem().expect("a page has a name").to_string_lossy().into_owned();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("documentation").join(&name);
    // The folder may not exist yet.
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("cargo's own folder");
    let ports = free_ports();
    let mut shell = Shell { page, folder: folder.clone(), programs, running: vec![] };
    let mut commands = 0;
    for block in &page.blocks {
        let text = ports.iter().fold(block.text.clone(), |text, (usual, free)| text.replace(usual, free));
        if let Some(file) = &block.file {
            std::fs::write(folder.join(file), text).expect("cargo's own folder");
        } else if block.language == "console" {
            commands += shell.run_steps(&steps(block.line, &text));
        }
    }
    assert!(commands > 0, "{}: there are no commands", page.path.display());
    folder
}

/// Returns the ports that pages use, each with a free port.
fn free_ports() -> Vec<(String, String)> {
    (7447..7451).map(|port| (format!("127.0.0.1:{port}"), format!("127.0.0.1:{}", free_port()))).collect()
}

/// Returns the commands of the code block that begins in line `first`.
fn steps(first: usize, text: &str) -> Vec<PageStep> {
    let mut steps: Vec<PageStep> = vec![];
    for (line, text) in (first + 1..).zip(text.lines()) {
        match (text.strip_prefix("$ "), steps.last_mut()) {
            (Some(command), _) => steps.push(PageStep { line, command: command.to_owned(), expected_output: vec![] }),
            // A long command continues in the next line.
            (None, Some(step)) if step.command.ends_with('\\') => {
                step.command.pop();
                step.command.push_str(text.trim_start());
            }
            (None, Some(step)) => step.expected_output.push(text.to_owned()),
            (None, None) => panic!("line {line}: output without a command"),
        }
    }
    steps
}

struct Shell<'a> {
    page: &'a Page,
    folder: PathBuf,
    programs: Programs<'a>,
    running: Vec<(String, Child)>,
}

impl Drop for Shell<'_> {
    fn drop(&mut self) {
        for (_, child) in &mut self.running {
            // The process may have ended already.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl Shell<'_> {
    /// Executes commands in order and returns their number.
    fn run_steps(&mut self, steps: &[PageStep]) -> usize {
        let mut steps = steps.iter().peekable();
        let mut count = 0;
        while let Some(step) = steps.next() {
            count += 1;
            if let Some(number) = step.command.strip_prefix("kill -9 %") {
                let number: usize =
                    number.parse().unwrap_or_else(|_| panic!("line {}: a process number is required", step.line));
                let (_, child) = &mut self.running[number - 1];
                child.kill().and_then(|()| child.wait()).expect("a program started by this test");
            } else if let Some(command) = step.command.strip_suffix('&') {
                self.start(command.trim_end(), step);
            } else {
                let code = steps.next_if(|next| next.command == "echo $?");
                let code = code.map_or("0".to_owned(), |next| next.expected_output.concat());
                self.run_until_expected(
                    step,
                    code.trim().parse().unwrap_or_else(|_| panic!("line {}: {code}", step.line)),
                );
            }
        }
        count
    }

    fn start(&mut self, command: &str, step: &PageStep) {
        let log = self.folder.join(format!("{}.log", self.running.len()));
        let file = std::fs::File::create(&log).expect("cargo's own folder");
        let child = self.command(command, step).stdout(Stdio::null()).stderr(file).spawn().expect("the program starts");
        self.running.push((command.to_owned(), child));
    }

    fn run_until_expected(&mut self, step: &PageStep, code: i32) {
        let since = Instant::now();
        let is_query = ["fleet", "missions", "explain", "doctor", "schedule list", "audit"]
            .iter()
            .any(|word| step.command.starts_with(&format!("consort {word}")));
        loop {
            let output = self.command(&step.command, step).output().expect("the program starts");
            let out = String::from_utf8_lossy(&output.stdout);
            let out = out.split_once(OUTPUT_MARKER).map_or(&*out, |(_, program)| program);
            let printed = format!("{out}{}", String::from_utf8_lossy(&output.stderr));
            let matches = output.status.code() == Some(code) && matches_pattern(&printed, &step.expected_output);
            if matches {
                return;
            }
            let again = is_query && !self.running.is_empty() && since.elapsed() < LIMIT;
            assert!(
                again,
                "{}:{}: $ {}\nended with {:?} instead of {code}, and printed:\n{printed}\n{}",
                self.page.path.display(),
                step.line,
                step.command,
                output.status.code(),
                self.logs()
            );
            std::thread::sleep(Duration::from_millis(200));
        }
    }

    /// Returns the last log lines of the running programs.
    fn logs(&self) -> String {
        let tail = |(number, (command, _)): (usize, &(String, Child))| {
            let log = std::fs::read_to_string(self.folder.join(format!("{number}.log"))).unwrap_or_default();
            let lines: Vec<&str> = log.lines().rev().take(8).collect();
            format!("{command}:\n{}", lines.into_iter().rev().collect::<Vec<_>>().join("\n"))
        };
        self.running.iter().enumerate().map(tail).collect::<Vec<_>>().join("\n")
    }

    fn command(&self, text: &str, step: &PageStep) -> Command {
        let of = |words: &str| {
            shlex::split(words).unwrap_or_else(|| panic!("line {}: a quote is not closed: {words}", step.line))
        };
        let mut command = match self.programs.iter().find_map(|(name, make)| Some((text.strip_prefix(name)?, make))) {
            Some((rest, make)) => make(&of(rest)),
            None => {
                let rest = text.strip_prefix("consort ");
                command(&of(rest.unwrap_or_else(|| panic!("line {}: {text:?} is no program of ours", step.line))))
            }
        };
        command.current_dir(&self.folder);
        command
    }
}

/// Returns a command for a program that the page tells readers to build. This test binary runs it:
/// see `tutorials::it_runs_as_a_program`.
pub(crate) fn substitute_program(name: &str, args: &[String]) -> Command {
    let mut command = program(
        std::env::current_exe().expect("this program"),
        &["--exact", "tutorials::it_runs_as_a_program", "--nocapture"],
    );
    command.env("CONSORT_TUTORIAL", name).env("CONSORT_TUTORIAL_ARGS", args.join("\n"));
    command
}

/// Checks whether a text matches the expected lines, in which `…` matches anything.
fn matches_pattern(text: &str, pattern: &[String]) -> bool {
    let words = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
    let lines: Vec<String> = text.lines().map(words).filter(|line| !line.is_empty()).collect();
    let pattern: Vec<String> = pattern.iter().map(|line| words(line)).filter(|line| !line.is_empty()).collect();
    matches_list(&lines, &pattern, &|line: &String, pattern: &String| {
        let pieces = |text: &str| text.chars().map(String::from).collect::<Vec<_>>();
        matches_list(&pieces(line), &pieces(pattern), &|a, b| a == b)
    })
}

/// Checks whether a list matches a pattern, in which `…` matches any number of elements.
fn matches_list(list: &[String], pattern: &[String], same: &dyn Fn(&String, &String) -> bool) -> bool {
    // Positions in the pattern at which the rest may match, after the elements of `list` so far.
    let skip = |mut at: Vec<bool>| {
        for place in 0..pattern.len() {
            at[place + 1] |= at[place] && pattern[place] == "…";
        }
        at
    };
    let mut at = vec![false; pattern.len() + 1];
    at[0] = true;
    at = skip(at);
    for element in list {
        let mut next = vec![false; pattern.len() + 1];
        for place in 0..pattern.len() {
            if at[place] {
                next[place] |= pattern[place] == "…";
                next[place + 1] |= pattern[place] != "…" && same(element, &pattern[place]);
            }
        }
        at = skip(next);
    }
    at[pattern.len()]
}

#[test]
fn output_is_compared_with_ellipses_as_wildcards() {
    let pattern = |lines: &[&str]| lines.iter().map(|line| (*line).to_owned()).collect::<Vec<_>>();
    let text = "a  1.5 s\n\nb 2\nc\n";
    assert!(matches_pattern(text, &pattern(&["a 1.5 s", "b   2", "c"])));
    assert!(matches_pattern(text, &pattern(&["a … s", "…"])) && matches_pattern(text, &pattern(&["…", "c"])));
    assert!(matches_pattern("x … y", &pattern(&["x … y"])));
    for wrong in [&["a 1.5 s", "c"][..], &["a … m", "…"], &["…", "b"], &["a 1.5 s", "b 2", "c", "d"], &[]] {
        assert!(!matches_pattern(text, &pattern(wrong)), "{wrong:?}");
    }
}

#[test]
fn commands_are_separated_from_their_output() {
    let text = "$ consort a \\\n    --b\nx\n$ consort c &\n";
    let step = |line, command: &str, expected_output: &[&str]| PageStep {
        line,
        command: command.to_owned(),
        expected_output: expected_output.iter().map(|line| (*line).to_owned()).collect(),
    };
    assert_eq!(steps(4, text), [step(5, "consort a --b", &["x"]), step(8, "consort c &", &[])]);
}
