//! Robustness against input of people and clients: any input is parsed or rejected quickly, on a
//! stack no larger than that of a worker thread.

use consort_protocol::ensemble::{ConditionError, Ensemble, EnsembleSpec};
use consort_protocol::ids::{EnsembleId, TaskType};
use consort_protocol::mission::{Domain, Format, MissionTemplate};
use consort_protocol::plan::divide_and_check;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use std::collections::BTreeSet;
use std::thread;
use std::time::{Duration, Instant};

/// Stack size of tokio's worker threads, which parse the input of clients.
const STACK: usize = 2 << 20;

/// Maximum time for parsing; tests are not optimised.
const TIME_MAX: Duration = Duration::from_secs(5);

/// Runs `work` on a stack like that of a worker, and checks its duration. A stack overflow aborts
/// the whole process.
#[track_caller]
fn in_time<T: Send>(what: &str, work: impl FnOnce() -> T + Send) -> T {
    let began = Instant::now();
    let done = thread::scope(|scope| {
        let builder = thread::Builder::new().stack_size(STACK);
        builder.spawn_scoped(scope, work).expect("a thread").join().expect("no panic")
    });
    let took = began.elapsed();
    assert!(took < TIME_MAX, "{took:?} for {}", what.chars().take(200).collect::<String>());
    done
}

/// Compiles a condition of an ensemble and evaluates it on an example.
fn condition(text: &str) -> Result<(), ConditionError> {
    let skills = BTreeSet::from([TaskType::new("navigation").expect("a slug")]);
    let spec = EnsembleSpec::with_any_skill_of(EnsembleId::new("e").expect("a slug"), skills);
    let spec = EnsembleSpec { membership: vec![text.to_owned()], ..spec };
    Ensemble::compile(spec).map(drop)
}

#[test]
fn deeply_nested_loops_are_rejected_before_they_run() {
    let digits = format!("[{}]", vec!["1"; 60].join(","));
    // 60⁶ iterations.
    let each = |inner: String, name: &str| format!("{digits}.all({name}, {inner})");
    let deep = ["a", "b", "c", "d", "e", "f"].into_iter().fold("true".to_owned(), each);
    let error = in_time(&deep, || condition(&deep)).unwrap_err().to_string();
    assert!(error.contains("loops are nested 6 deep; at most 2 levels are allowed"), "{error}");
    // Each loop iterates over a list that the preceding loop has doubled.
    let doubled = (0..20).fold("[1]".to_owned(), |list, _| format!("[{list}].map(l, l+l)[0]")) + ".size() > 0";
    let error = in_time(&doubled, || condition(&doubled)).unwrap_err().to_string();
    assert!(error.contains("20 deep"), "{error}");
    // Two levels are allowed, and any number of loops in sequence.
    let two = format!("{digits}.all(a, {digits}.exists(b, a == b))");
    assert_eq!(in_time(&two, || condition(&two)), Ok(()));
    let in_sequence = ["member.skills.exists(s, s in ensemble.skills)"; 12].join(" && ");
    assert_eq!(in_time(&in_sequence, || condition(&in_sequence)), Ok(()));
}

#[test]
fn deeply_nested_input_is_rejected() {
    for (open, close) in
        [("(", ")"), ("[", "]"), ("!", ""), ("-", ""), ("{1:", "}"), ("a?b:", ""), ("a.", ""), ("f(", ")")]
    {
        let times = 1000 / (open.len() + close.len());
        let text = format!("{}true{}", open.repeat(times), close.repeat(times));
        // Some are invalid, some are too deep, some are valid: all end in time.
        let _ = in_time(&text, || condition(&text));
    }
    let head = "mission: m\nroles: { r1: { kind: managed } }\nroot: ";
    for (open, close) in
        [("[", "]"), ("{", "}"), ("{ tasks: [", "]}"), ("- ", ""), ("\"", ""), ("? ", ""), ("&a [", "]"), ("!!x ", "")]
    {
        let times = 100_000 / (open.len() + close.len());
        let text = format!("{head}{}x{}", open.repeat(times), close.repeat(times));
        assert!(in_time(&text, || MissionTemplate::parse(&text, Format::Yaml)).is_err(), "{open}");
        assert!(in_time(&text, || MissionTemplate::request(&text, Format::Yaml)).is_err(), "{open}");
    }
    for (open, close) in [("[", "]"), ("{\"root\":", "}"), ("{\"root\":{\"tasks\":[", "]}}")] {
        let times = 200_000 / (open.len() + close.len());
        let text = format!("{}1{}", open.repeat(times), close.repeat(times));
        assert!(in_time(&text, || MissionTemplate::parse(&text, Format::Json)).is_err(), "{open}");
    }
    // A few lines that would expand to gigabytes.
    let alias_bomb = (1..12).fold("a0: &a0 [x,x]\n".to_owned(), |text, level| {
        let before = level - 1;
        format!("{text}a{level}: &a{level} [*a{before},*a{before},*a{before},*a{before},*a{before}]\n")
    });
    assert!(in_time(&alias_bomb, || MissionTemplate::parse(&alias_bomb, Format::Yaml)).is_err());
}

const FETCH_PARCEL: &str = include_str!("data/fetch-parcel.yaml");

fn edits() -> impl Strategy<Value = Vec<(Index, usize, String)>> {
    prop::collection::vec((any::<Index>(), 0_usize..40, "[ -~\n]{0,6}"), 1..8)
}

/// Returns the text with the edits applied.
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

fn domain() -> Domain {
    serde_saphyr::from_str(include_str!("data/domain.yaml")).expect("a domain")
}

/// Parses a mission, and if it is valid, instantiates and divides it.
fn plan(text: &str, format: Format) {
    if let Ok(template) = MissionTemplate::parse(text, format) {
        let given = template.parameters().keys().map(|name| (name.clone(), "IC Room 6".to_owned())).collect();
        if let Ok(mission) = template.instantiate(&given, &domain()) {
            let _ = divide_and_check(&mission);
        }
    }
}

proptest! {
    #[test]
    fn a_mutated_mission_is_planned_or_rejected(edits in edits()) {
        let text = edited(FETCH_PARCEL, &edits);
        in_time(&text, || plan(&text, Format::Yaml));
    }

    #[test]
    fn a_mutated_request_is_planned_or_rejected(edits in edits()) {
        let json = MissionTemplate::request(FETCH_PARCEL, Format::Yaml).expect("the mission is valid").to_string();
        let text = edited(&json, &edits);
        in_time(&text, || plan(&text, Format::Json));
    }

    #[test]
    fn no_condition_makes_a_node_hang_or_panic(words in prop::collection::vec(select(vec![
        "member", "coordinator", "ensemble", ".skills", ".name", ".battery", ".all(a, ", ".exists(b, ", ".map(c, ", ".filter(d, ",
        "a", "b", "(", ")", "[", "]", "{", "}", ",", ":", "?", " in ", " && ", " || ", " + ", " * ", " / ", " % ", " - ", "!", " == ", " < ",
        "0", "1", "9223372036854775807", "-1.5e308", "'x'", "b'y'", "true", "null", "size(", "has(", "int(", "string(", "duration('1h')",
        "timestamp('2026-01-01T00:00:00Z')", "9u", "\"", "\\", "é",
    ]), 0..60)) {
        let text = words.concat();
        let _ = in_time(&text, || condition(&text));
    }
}
