//! Files that are small but expand to large or deep structures. Every format rejects them quickly,
//! on a stack as small as that of a server thread.

use crate::{ImportError, read};
use std::thread;
use std::time::{Duration, Instant};

/// Time limit for reading in an unoptimised test build.
const TIME_LIMIT: Duration = Duration::from_secs(20);

/// Reads a text as a file with this name, within the time limit.
#[track_caller]
fn read_in_time(text: &str, file: &str) -> Result<(), ImportError> {
    let began = Instant::now();
    let read = thread::scope(|scope| {
        let reading = thread::Builder::new().stack_size(2 << 20);
        let reading = reading.spawn_scoped(scope, || read(text, file).map(drop));
        reading.expect("the thread starts").join().expect("reading does not panic")
    });
    assert!(began.elapsed() < TIME_LIMIT, "{:?} for {file}", began.elapsed());
    read
}

#[test]
fn deeply_nested_files_are_rejected() {
    let depth = 50_000;
    for (file, head) in [("a.yaml", "name: m\nplaces: "), ("a.building.yaml", "name: m\nlevels: ")] {
        for (open, close) in [("[", "]"), ("{a: ", "}"), ("- ", ""), ("? ", ""), ("!!x ", ""), ("&a [", "]")] {
            let text = format!("{head}{}x{}", open.repeat(depth), close.repeat(depth));
            assert!(read_in_time(&text, file).is_err(), "{file}: {open}");
        }
    }
    for (open, close) in [("[", "]"), ("{\"a\":", "}")] {
        let text = format!("{{\"name\":\"m\",\"places\":{}1{}}}", open.repeat(depth), close.repeat(depth));
        assert!(read_in_time(&text, "a.json").is_err(), "{open}");
    }
    for (head, foot) in [("", ""), ("<mxGraphModel><root>", "</root></mxGraphModel>")] {
        for (cell, end) in [
            ("<a>", "</a>"),
            ("<mxCell id=\"1\" parent=\"1\">", "</mxCell>"),
            ("<object><mxCell>", "</mxCell></object>"),
        ] {
            let text = format!("{head}{}{}{foot}", cell.repeat(depth), end.repeat(depth));
            assert!(read_in_time(&text, "a.drawio").is_err(), "{cell}");
        }
    }
}

#[test]
fn files_that_expand_to_gigabytes_are_rejected() {
    let anchors = (1..12).fold("a0: &a0 [x,x]\n".to_owned(), |text, level| {
        let before = level - 1;
        format!("{text}a{level}: &a{level} [*a{before},*a{before},*a{before},*a{before},*a{before},*a{before}]\n")
    });
    for file in ["a.yaml", "a.building.yaml"] {
        assert!(read_in_time(&format!("{anchors}name: m\n"), file).is_err(), "{file}");
        assert!(read_in_time(&format!("{anchors}levels: *a11\n"), file).is_err(), "{file}");
    }
    let entities: String =
        (1..12).map(|level| format!("<!ENTITY e{level} \"{}\">", format!("&e{};", level - 1).repeat(10))).collect();
    let bomb =
        format!("<!DOCTYPE mxfile [<!ENTITY e0 \"x\">{entities}]><mxGraphModel><root>&e11;</root></mxGraphModel>");
    let reason = read_in_time(&bomb, "a.drawio").unwrap_err().to_string();
    assert!(reason.contains("DTD"), "{reason}");
}
