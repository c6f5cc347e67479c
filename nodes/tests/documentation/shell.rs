//! Plays a page as a reader would at a terminal: its files are written, its commands are given, and what they print is compared.
//!
//! - ```` ```yaml ward.yaml ```` is a file of that name.
//! - ```` ```console ```` has commands behind `$ ` and, under each, what it prints; `…` stands for anything, in a line or for lines,
//!   and how many blanks stand between words does not matter. A command must succeed, unless `$ echo $?` follows and says otherwise.
//! - A command that ends in `&` runs until the end of the page, or until `$ kill -9 %N` for the Nth of them. From then on a command that asks how things are is repeated
//!   until it prints what it should, for a generous while: nodes take their time to meet.
//!
//! Ports of the page are exchanged for free ones, so that pages do not get into one another's way.

use super::binary::{consort, program};
use super::page::Page;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longest that is waited until a command prints what it should.
const LIMIT: Duration = Duration::from_secs(90);

/// What a program that this one plays prints comes behind this; what stands before is said by the test that plays it.
pub(crate) const OUTPUT_MARKER: &str = "\n== the program ==\n";

/// How programs that are not `consort` are started: the words that name one, and its command.
pub(crate) type Programs<'a> = &'a [(&'a str, fn(&[String]) -> Command)];

/// A command and what it prints.
#[derive(Debug, PartialEq, Eq)]
struct Deed {
    line: usize,
    command: String,
    prints: Vec<String>,
}

/// Plays a page in a folder of its own, where its files are left.
///
/// # Panics
/// Where a command does not do what the page says, with the page's line.
pub(crate) fn run_page(page: &Page, programs: Programs<'_>) -> PathBuf {
    let name = page.path.file_stem().expect("a page has a name").to_string_lossy().into_owned();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("documentation").join(&name);
    // There may be none yet.
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("cargo's own folder");
    let ports = free_ports();
    let mut shell = Shell { page, folder: folder.clone(), programs, running: vec![] };
    let mut told = 0;
    for block in &page.blocks {
        let text = ports.iter().fold(block.text.clone(), |text, (usual, free)| text.replace(usual, free));
        if let Some(file) = &block.file {
            std::fs::write(folder.join(file), text).expect("cargo's own folder");
        } else if block.language == "console" {
            told += shell.give(&deeds(block.line, &text));
        }
    }
    assert!(told > 0, "{}: there are no commands", page.path.display());
    folder
}

/// The ports that pages use, each with one that was free a moment ago.
fn free_ports() -> Vec<(String, String)> {
    let taken: Vec<TcpListener> = (0..4).map(|_| TcpListener::bind("127.0.0.1:0").expect("a free port")).collect();
    let free = taken.iter().map(|listener| format!("127.0.0.1:{}", listener.local_addr().expect("its address").port()));
    (7447..).map(|port| format!("127.0.0.1:{port}")).zip(free).collect()
}

/// The commands of a block, whose fence is in line `first`.
fn deeds(first: usize, text: &str) -> Vec<Deed> {
    let mut deeds: Vec<Deed> = vec![];
    for (line, text) in (first + 1..).zip(text.lines()) {
        match (text.strip_prefix("$ "), deeds.last_mut()) {
            (Some(command), _) => deeds.push(Deed { line, command: command.to_owned(), prints: vec![] }),
            // A command that is too long for one line goes on in the next.
            (None, Some(deed)) if deed.command.ends_with('\\') => {
                deed.command.pop();
                deed.command.push_str(text.trim_start());
            }
            (None, Some(deed)) => deed.prints.push(text.to_owned()),
            (None, None) => panic!("line {line}: output without a command"),
        }
    }
    deeds
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
            // It may have ended already.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl Shell<'_> {
    /// Gives commands one after the other; how many there were.
    fn give(&mut self, deeds: &[Deed]) -> usize {
        let mut deeds = deeds.iter().peekable();
        let mut given = 0;
        while let Some(deed) = deeds.next() {
            given += 1;
            if let Some(number) = deed.command.strip_prefix("kill -9 %") {
                let number: usize = number.parse().unwrap_or_else(|_| panic!("line {}: which one?", deed.line));
                let (_, child) = &mut self.running[number - 1];
                child.kill().and_then(|()| child.wait()).expect("a program that this one has started");
            } else if let Some(command) = deed.command.strip_suffix('&') {
                self.start(command.trim_end(), deed);
            } else {
                let code = deeds.next_if(|next| next.command == "echo $?");
                let code = code.map_or("0".to_owned(), |next| next.prints.concat());
                self.until_it_prints(
                    deed,
                    code.trim().parse().unwrap_or_else(|_| panic!("line {}: {code}", deed.line)),
                );
            }
        }
        given
    }

    fn start(&mut self, command: &str, deed: &Deed) {
        let log = self.folder.join(format!("{}.log", self.running.len()));
        let file = std::fs::File::create(&log).expect("cargo's own folder");
        let child = self.command(command, deed).stdout(Stdio::null()).stderr(file).spawn().expect("the program starts");
        self.running.push((command.to_owned(), child));
    }

    fn until_it_prints(&mut self, deed: &Deed, code: i32) {
        let since = Instant::now();
        let asks = ["fleet", "missions", "explain", "doctor"]
            .iter()
            .any(|word| deed.command.starts_with(&format!("consort {word}")));
        loop {
            let output = self.command(&deed.command, deed).output().expect("the program starts");
            let out = String::from_utf8_lossy(&output.stdout);
            let out = out.split_once(OUTPUT_MARKER).map_or(&*out, |(_, program)| program);
            let printed = format!("{out}{}", String::from_utf8_lossy(&output.stderr));
            let as_told = output.status.code() == Some(code) && is_as_told(&printed, &deed.prints);
            if as_told {
                return;
            }
            let again = asks && !self.running.is_empty() && since.elapsed() < LIMIT;
            assert!(
                again,
                "{}:{}: $ {}\nended with {:?} where {code} was awaited, and printed:\n{printed}\n{}",
                self.page.path.display(),
                deed.line,
                deed.command,
                output.status.code(),
                self.logs()
            );
            std::thread::sleep(Duration::from_millis(200));
        }
    }

    /// What the programs that run have said last.
    fn logs(&self) -> String {
        let tail = |(number, (command, _)): (usize, &(String, Child))| {
            let log = std::fs::read_to_string(self.folder.join(format!("{number}.log"))).unwrap_or_default();
            let lines: Vec<&str> = log.lines().rev().take(8).collect();
            format!("{command}:\n{}", lines.into_iter().rev().collect::<Vec<_>>().join("\n"))
        };
        self.running.iter().enumerate().map(tail).collect::<Vec<_>>().join("\n")
    }

    fn command(&self, text: &str, deed: &Deed) -> Command {
        let of = |words: &str| {
            shlex::split(words).unwrap_or_else(|| panic!("line {}: a quote is not closed: {words}", deed.line))
        };
        let mut command = match self.programs.iter().find_map(|(name, make)| Some((text.strip_prefix(name)?, make))) {
            Some((rest, make)) => make(&of(rest)),
            None => {
                let rest = text.strip_prefix("consort ");
                consort(&of(rest.unwrap_or_else(|| panic!("line {}: {text:?} is no program of ours", deed.line))))
            }
        };
        command.current_dir(&self.folder);
        command
    }
}

/// A program that the page has readers build, played by this one: see `tutorials::as_a_program`.
pub(crate) fn substitute_program(name: &str, args: &[String]) -> Command {
    let mut command =
        program(std::env::current_exe().expect("this program"), &["--exact", "tutorials::as_a_program", "--nocapture"]);
    command.env("CONSORT_TUTORIAL", name).env("CONSORT_TUTORIAL_ARGS", args.join("\n"));
    command
}

/// Whether a text is what is expected, where `…` stands for anything.
fn is_as_told(text: &str, told: &[String]) -> bool {
    let words = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
    let lines: Vec<String> = text.lines().map(words).filter(|line| !line.is_empty()).collect();
    let told: Vec<String> = told.iter().map(|line| words(line)).filter(|line| !line.is_empty()).collect();
    fit(&lines, &told, &|line: &String, told: &String| {
        let pieces = |text: &str| text.chars().map(String::from).collect::<Vec<_>>();
        fit(&pieces(line), &pieces(told), &|a, b| a == b)
    })
}

/// Whether a list matches another, in which `…` stands for any number of elements.
fn fit(list: &[String], told: &[String], same: &dyn Fn(&String, &String) -> bool) -> bool {
    // From which places on in `told` the rest may be matched, after what was looked at of `list`.
    let skip = |mut at: Vec<bool>| {
        for place in 0..told.len() {
            at[place + 1] |= at[place] && told[place] == "…";
        }
        at
    };
    let mut at = vec![false; told.len() + 1];
    at[0] = true;
    at = skip(at);
    for element in list {
        let mut next = vec![false; told.len() + 1];
        for place in 0..told.len() {
            if at[place] {
                next[place] |= told[place] == "…";
                next[place + 1] |= told[place] != "…" && same(element, &told[place]);
            }
        }
        at = skip(next);
    }
    at[told.len()]
}

#[test]
fn what_is_printed_is_compared_but_for_what_is_left_out() {
    let told = |lines: &[&str]| lines.iter().map(|line| (*line).to_owned()).collect::<Vec<_>>();
    let text = "a  1.5 s\n\nb 2\nc\n";
    assert!(is_as_told(text, &told(&["a 1.5 s", "b   2", "c"])));
    assert!(is_as_told(text, &told(&["a … s", "…"])) && is_as_told(text, &told(&["…", "c"])));
    assert!(is_as_told("x … y", &told(&["x … y"])));
    for wrong in [&["a 1.5 s", "c"][..], &["a … m", "…"], &["…", "b"], &["a 1.5 s", "b 2", "c", "d"], &[]] {
        assert!(!is_as_told(text, &told(wrong)), "{wrong:?}");
    }
}

#[test]
fn commands_are_told_from_what_they_print() {
    let text = "$ consort a \\\n    --b\nx\n$ consort c &\n";
    let deed = |line, command: &str, prints: &[&str]| Deed {
        line,
        command: command.to_owned(),
        prints: prints.iter().map(|line| (*line).to_owned()).collect(),
    };
    assert_eq!(deeds(4, text), [deed(5, "consort a --b", &["x"]), deed(8, "consort c &", &[])]);
}
