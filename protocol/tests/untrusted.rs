//! What people and clients write: whatever it is, it is read or refused, soon, and on a stack no larger than a worker's.

use consort_protocol::ensemble::{Ensemble, EnsembleSpec};
use consort_protocol::ids::{EnsembleId, TaskType};
use consort_protocol::mission::{Domain, Format, MissionTemplate};
use consort_protocol::plan::divide_and_check;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use std::collections::BTreeSet;
use std::thread;
use std::time::{Duration, Instant};

/// What tokio gives its workers, which read what clients send.
const STACK: usize = 2 << 20;

/// How long reading may take, tests not being optimised.
const SOON: Duration = Duration::from_secs(5);

/// Does something on a stack like a worker's, and sees that it takes no longer than allowed. A stack that is too small ends the
/// whole process.
#[track_caller]
fn soon<T: Send>(what: &str, work: impl FnOnce() -> T + Send) -> T {
    let began = Instant::now();
    let done = thread::scope(|scope| {
        let builder = thread::Builder::new().stack_size(STACK);
        builder.spawn_scoped(scope, work).expect("a thread").join().expect("no panic")
    });
    let took = began.elapsed();
    assert!(took < SOON, "{took:?} for {}", what.chars().take(200).collect::<String>());
    done
}

/// A condition of an ensemble, compiled and tried on an example.
fn condition(text: &str) -> Result<(), String> {
    let skills = BTreeSet::from([TaskType::new("navigation").expect("a slug")]);
    let spec = EnsembleSpec::with_any_skill_of(EnsembleId::new("e").expect("a slug"), skills);
    let spec = EnsembleSpec { membership: vec![text.to_owned()], ..spec };
    Ensemble::compile(spec).map(drop).map_err(|problem| problem.to_string())
}

#[test]
fn loops_in_loops_are_refused_before_they_run() {
    let digits = format!("[{}]", vec!["1"; 60].join(","));
    // Sixty to the sixth power.
    let each = |inner: String, name: &str| format!("{digits}.all({name}, {inner})");
    let deep = ["a", "b", "c", "d", "e", "f"].into_iter().fold("true".to_owned(), each);
    let why = soon(&deep, || condition(&deep)).unwrap_err();
    assert!(why.contains("its loops stand 6 deep in one another, where 2 are allowed"), "{why}");
    // Each goes over what the one before it has doubled.
    let doubled = (0..20).fold("[1]".to_owned(), |list, _| format!("[{list}].map(l, l+l)[0]")) + ".size() > 0";
    let why = soon(&doubled, || condition(&doubled)).unwrap_err();
    assert!(why.contains("20 deep"), "{why}");
    // Two may, and beside one another as many as there is room for.
    let two = format!("{digits}.all(a, {digits}.exists(b, a == b))");
    assert_eq!(soon(&two, || condition(&two)), Ok(()));
    let beside = ["member.skills.exists(s, s in ensemble.skills)"; 12].join(" && ");
    assert_eq!(soon(&beside, || condition(&beside)), Ok(()));
}

#[test]
fn what_is_nested_without_end_is_refused() {
    for (open, close) in
        [("(", ")"), ("[", "]"), ("!", ""), ("-", ""), ("{1:", "}"), ("a?b:", ""), ("a.", ""), ("f(", ")")]
    {
        let times = 1000 / (open.len() + close.len());
        let text = format!("{}true{}", open.repeat(times), close.repeat(times));
        // Some are no condition, some are too deep, some are yes or no after all: all are answered.
        let _ = soon(&text, || condition(&text));
    }
    let head = "mission: m\nroles: { r1: { kind: managed } }\nroot: ";
    for (open, close) in
        [("[", "]"), ("{", "}"), ("{ tasks: [", "]}"), ("- ", ""), ("\"", ""), ("? ", ""), ("&a [", "]"), ("!!x ", "")]
    {
        let times = 100_000 / (open.len() + close.len());
        let text = format!("{head}{}x{}", open.repeat(times), close.repeat(times));
        assert!(soon(&text, || MissionTemplate::parse(&text, Format::Yaml)).is_err(), "{open}");
        assert!(soon(&text, || MissionTemplate::request(&text, Format::Yaml)).is_err(), "{open}");
    }
    for (open, close) in [("[", "]"), ("{\"root\":", "}"), ("{\"root\":{\"tasks\":[", "]}}")] {
        let times = 200_000 / (open.len() + close.len());
        let text = format!("{}1{}", open.repeat(times), close.repeat(times));
        assert!(soon(&text, || MissionTemplate::parse(&text, Format::Json)).is_err(), "{open}");
    }
    // A few lines that would be gigabytes.
    let laughs = (1..12).fold("a0: &a0 [x,x]\n".to_owned(), |text, level| {
        let before = level - 1;
        format!("{text}a{level}: &a{level} [*a{before},*a{before},*a{before},*a{before},*a{before}]\n")
    });
    assert!(soon(&laughs, || MissionTemplate::parse(&laughs, Format::Yaml)).is_err());
}

const LAB_SAMPLES: &str = include_str!("../missions/lab-samples.yaml");

fn edits() -> impl Strategy<Value = Vec<(Index, usize, String)>> {
    prop::collection::vec((any::<Index>(), 0_usize..40, "[ -~\n]{0,6}"), 1..8)
}

/// A text with parts cut out and others put in.
fn edited(text: &str, edits: &[(Index, usize, String)]) -> String {
    let mut text = text.to_owned();
    for (at, cut, put) in edits {
        let at = at.index(text.len().max(1));
        let end = (at + cut).min(text.len());
        if text.is_char_boundary(at) && text.is_char_boundary(end) {
            text.replace_range(at..end, put);
        }
    }
    text
}

/// Reads a mission, and if it can be read, works out what a request for it would be.
fn planned(text: &str, format: Format) {
    if let Ok(template) = MissionTemplate::parse(text, format) {
        let given = template.parameters().keys().map(|name| (name.clone(), "IC Room 6".to_owned())).collect();
        if let Ok(mission) = template.instantiate(&given, &Domain::hospital()) {
            let _ = divide_and_check(&mission);
        }
    }
}

proptest! {
    #[test]
    fn a_mutated_mission_is_planned_or_refused(edits in edits()) {
        let text = edited(LAB_SAMPLES, &edits);
        soon(&text, || planned(&text, Format::Yaml));
    }

    #[test]
    fn a_mutated_request_is_planned_or_refused(edits in edits()) {
        let json = MissionTemplate::request(LAB_SAMPLES, Format::Yaml).expect("it is shipped").to_string();
        let text = edited(&json, &edits);
        soon(&text, || planned(&text, Format::Json));
    }

    #[test]
    fn no_condition_makes_a_node_hang_or_panic(words in prop::collection::vec(select(vec![
        "member", "coordinator", "ensemble", ".skills", ".name", ".battery", ".all(a, ", ".exists(b, ", ".map(c, ", ".filter(d, ",
        "a", "b", "(", ")", "[", "]", "{", "}", ",", ":", "?", " in ", " && ", " || ", " + ", " * ", " / ", " % ", " - ", "!", " == ", " < ",
        "0", "1", "9223372036854775807", "-1.5e308", "'x'", "b'y'", "true", "null", "size(", "has(", "int(", "string(", "duration('1h')",
        "timestamp('2026-01-01T00:00:00Z')", "9u", "\"", "\\", "é",
    ]), 0..60)) {
        let text = words.concat();
        let _ = soon(&text, || condition(&text));
    }
}
