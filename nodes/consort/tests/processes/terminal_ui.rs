//! `consort watch` on a terminal that `script` (util-linux) provides. Without that program the test
//! is skipped.

use crate::support::{Fleet, Folder, LONG, example, skip, until};
use std::fs;
use std::io::Write as _;
use std::process::{Child, Command, Stdio};

/// Size of the terminal: lines and columns.
const SIZE: (usize, usize) = (40, 140);

/// Sequences that leave the alternate screen and that show the cursor.
const LEAVE: &str = "\x1b[?1049l";
const CURSOR: &str = "\x1b[?25h";

/// A command on its own terminal, killed on drop.
struct Terminal {
    child: Child,
    folder: Folder,
}

impl Terminal {
    /// Runs `consort` on a new terminal. Returns `None` and skips the test if there can be no
    /// terminal. After its end the terminal shows its exit code and whether the terminal settings
    /// were restored.
    fn start(arguments: &[&str]) -> Option<Terminal> {
        let there = Command::new("script").arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
        if !there.is_ok_and(|status| status.success()) {
            skip("no program script (apt-get install bsdutils)");
            return None;
        }
        let (folder, (lines, columns)) = (Folder::new(), SIZE);
        let words = std::iter::once(env!("CARGO_BIN_EXE_consort")).chain(arguments.iter().copied());
        let line: Vec<String> = words.map(|word| format!("'{word}'")).collect();
        let shell = format!(
            "stty rows {lines} cols {columns}; before=$(stty -g); {}; code=$?; \
             [ \"$before\" = \"$(stty -g)\" ] && echo \"ended $code as before\" || echo \"ended $code otherwise\"",
            line.join(" ")
        );
        let mut command = Command::new("script");
        command.args(["--quiet", "--flush", "--command", &shell]).arg(folder.path().join("typescript"));
        command.env("TERM", "xterm-256color").env("SHELL", "/bin/sh").env("TMPDIR", folder.temporary());
        command.env_remove("NO_COLOR").stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
        let child = command.spawn().expect("it was there a moment ago");
        Some(Terminal { child, folder })
    }

    fn press(&mut self, keys: &str) {
        let stdin = self.child.stdin.as_mut().expect("it is piped");
        stdin.write_all(keys.as_bytes()).and_then(|()| stdin.flush()).expect("the terminal is there");
    }

    /// Returns everything written to the terminal.
    fn written(&self) -> String {
        let bytes = fs::read(self.folder.path().join("typescript")).unwrap_or_default();
        // `script` writes the first line.
        String::from_utf8_lossy(&bytes).split_once('\n').map(|(_, written)| written.to_owned()).unwrap_or_default()
    }

    /// Returns the current screen content.
    fn screen(&self) -> String {
        shown(&self.written())
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // It may have ended. Processes on its terminal contain the name of the folder and end with
        // the folder.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Interprets the output: characters at the cursor, and cursor movements. Colours and other
/// attributes are ignored.
fn shown(written: &str) -> String {
    let mut screen = vec![vec![' '; SIZE.1]; SIZE.0];
    let (mut line, mut column) = (0_usize, 0_usize);
    let mut letters = written.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            '\x1b' if letters.next_if_eq(&'[').is_some() => {
                let mut numbers = String::new();
                let last = loop {
                    match letters.next() {
                        Some(letter @ '@'..='~') => break letter,
                        Some(letter) => numbers.push(letter),
                        None => break ' ', // the rest is still on its way
                    }
                };
                match (last, numbers.split_once(';').map(|(line, column)| (line.parse(), column.parse()))) {
                    ('H', Some((Ok(to_line), Ok(to_column)))) => (line, column) = (to_line, to_column),
                    ('H', _) => (line, column) = (1, 1),
                    ('J', _) => screen.iter_mut().for_each(|line| line.fill(' ')),
                    _ => continue,
                }
                (line, column) = (line.saturating_sub(1), column.saturating_sub(1));
            }
            '\r' => column = 0,
            '\n' => line += 1,
            letter => {
                if let Some(cell) = screen.get_mut(line).and_then(|line| line.get_mut(column)) {
                    *cell = letter;
                }
                column += 1;
            }
        }
    }
    screen.iter().map(|line| line.iter().collect::<String>().trim_end().to_owned() + "\n").collect()
}

#[test]
fn watch_draws_the_fleet_and_restores_the_terminal() {
    let mut file = example("fleet");
    file.insert("name".to_owned(), "watched".into());
    file.insert("bootstrap_expect".to_owned(), 1.into());
    let mut fleet = Fleet::new(&file);
    fleet.start("station", example("station"), &[]);
    fleet.start("world", example("world"), &["station-1"]);
    fleet.start("robot", example("robot"), &["station-1", "world"]);
    let address = fleet.address("station-1");
    let watch = ["watch", "--fleet", "watched", "--connect", &address, "--timeout", "30"];
    if let Some(mut terminal) = Terminal::start(&watch) {
        fn has<'a>(parts: &'a [&'a str]) -> impl Fn(&String) -> bool + 'a {
            move |screen| parts.iter().all(|part| screen.contains(part))
        }
        let parts = ["coordinator ", ", term ", "ada", "90 %", "q quit"];
        let mut screen = String::new();
        until("the fleet is drawn", LONG, || {
            screen = terminal.screen();
            has(&parts)(&screen).then_some(())
        });
        assert!(!screen.contains("lab-samples-1"), "{screen}");
        let submit = ["submit", "lab-samples", "--set", "room=IC Room 6"];
        fleet.run(&submit, "station-1").expect(0);
        until("the mission appears", LONG, || has(&["lab-samples-1"])(&terminal.screen()).then_some(()));

        // BackTab selects the robots, of which ada is the only one.
        terminal.press("\x1b[Zha spill\r\r");
        until("the question", LONG, || has(&["Hold ada? It stands still"])(&terminal.screen()).then_some(()));
        terminal.press("y");
        until("the robot is held", LONG, || {
            let nodes = fleet.run(&["fleet", "--json"], "station-1").expect(0).json()["fleet"]["nodes"].clone();
            let ada = nodes.as_array()?.iter().find(|node| node["node"] == "ada")?;
            (ada["orders"]["hold"]["reason"] == "a spill").then_some(())
        });
        until("the result", LONG, || has(&["hold ada: done"])(&terminal.screen()).then_some(()));
        terminal.press("Rall\r");
        until("the question", LONG, || has(&["Release all robots?"])(&terminal.screen()).then_some(()));
        terminal.press("y");
        until("the result", LONG, || has(&["release all robots: done: ada"])(&terminal.screen()).then_some(()));

        terminal.press("\t\tq");
        let written = until("it has ended", LONG, || Some(terminal.written()).filter(|text| text.contains("ended ")));
        let (drawn, after) = written.rsplit_once(LEAVE).expect("it leaves its own screen");
        assert!(after.contains("ended 0 as before"), "{after:?}");
        assert!(drawn.contains(CURSOR) || after.contains(CURSOR), "the cursor stays hidden");
    }
    fleet.stop();
}
