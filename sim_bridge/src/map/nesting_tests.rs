//! Files that are small and would be large, or deep: each form refuses them soon, on a stack like that of a server's thread.

use super::*;
use std::thread;
use std::time::{Duration, Instant};

/// How long reading may take, tests not being optimised.
const SOON: Duration = Duration::from_secs(20);

/// What becomes of a text in a file of this name.
#[track_caller]
fn soon(text: &str, file: &str) -> Result<(), String> {
    let began = Instant::now();
    let read = thread::scope(|scope| {
        let reading = thread::Builder::new().stack_size(2 << 20);
        let reading = reading.spawn_scoped(scope, || read(text, file).map(drop).map_err(|problem| problem.to_string()));
        reading.expect("a thread").join().expect("no panic")
    });
    assert!(began.elapsed() < SOON, "{:?} for {file}", began.elapsed());
    read
}

#[test]
fn what_is_nested_without_end_is_refused() {
    let depth = 50_000;
    for (file, head) in [("a.yaml", "name: m\nplaces: "), ("a.building.yaml", "name: m\nlevels: ")] {
        for (open, close) in [("[", "]"), ("{a: ", "}"), ("- ", ""), ("? ", ""), ("!!x ", ""), ("&a [", "]")] {
            let text = format!("{head}{}x{}", open.repeat(depth), close.repeat(depth));
            assert!(soon(&text, file).is_err(), "{file}: {open}");
        }
    }
    for (open, close) in [("[", "]"), ("{\"a\":", "}")] {
        let text = format!("{{\"name\":\"m\",\"places\":{}1{}}}", open.repeat(depth), close.repeat(depth));
        assert!(soon(&text, "a.json").is_err(), "{open}");
    }
    for (head, foot) in [("", ""), ("<mxGraphModel><root>", "</root></mxGraphModel>")] {
        for (cell, end) in [
            ("<a>", "</a>"),
            ("<mxCell id=\"1\" parent=\"1\">", "</mxCell>"),
            ("<object><mxCell>", "</mxCell></object>"),
        ] {
            let text = format!("{head}{}{}{foot}", cell.repeat(depth), end.repeat(depth));
            assert!(soon(&text, "a.drawio").is_err(), "{cell}");
        }
    }
}

#[test]
fn a_few_lines_that_would_be_gigabytes_are_refused() {
    let laughs = (1..12).fold("a0: &a0 [x,x]\n".to_owned(), |text, level| {
        let before = level - 1;
        format!("{text}a{level}: &a{level} [*a{before},*a{before},*a{before},*a{before},*a{before},*a{before}]\n")
    });
    for file in ["a.yaml", "a.building.yaml"] {
        assert!(soon(&format!("{laughs}name: m\n"), file).is_err(), "{file}");
        assert!(soon(&format!("{laughs}levels: *a11\n"), file).is_err(), "{file}");
    }
    let entities: String =
        (1..12).map(|level| format!("<!ENTITY e{level} \"{}\">", format!("&e{};", level - 1).repeat(10))).collect();
    let bomb =
        format!("<!DOCTYPE mxfile [<!ENTITY e0 \"x\">{entities}]><mxGraphModel><root>&e11;</root></mxGraphModel>");
    let why = soon(&bomb, "a.drawio").unwrap_err();
    assert!(why.contains("DTD"), "{why}");
}
