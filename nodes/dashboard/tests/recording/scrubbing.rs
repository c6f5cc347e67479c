//! A recording shows at every instant the state that was shown live, however the reader reaches it.

use crate::support::*;
use consort_dashboard::fleet_model::{FleetInput, delta};
use consort_dashboard::recording::{KEYFRAMES_MAX, RecordingReader, TimelineMarkKind};
use proptest::prelude::*;
use serde_json::{Value, json};

/// Returns the inputs of a mission during which the coordinator fails, with their times.
fn story() -> Vec<(u64, FleetInput)> {
    let of = |what: &str| json!({ "event": what, "mission": "m-1", "role": "r1", "task": "go" });
    let state = |state: &str| json!({ "event": "mission", "mission": "m-1", "state": state, "submitted_at_ms": BEGAN });
    vec![
        (5, map()),
        (10, robots(&["ada", "bob"])),
        (12, world(false, "closed")),
        (20, beacon("s-1", 1, 500)),
        (30, FleetInput::Links(1)),
        (
            1000,
            event(
                "s-1",
                40,
                999,
                json!({ "event": "submitted", "mission": "m-1", "parameters": { "room": "IC Room 6" } }),
            ),
        ),
        (1001, event("s-1", 41, 1000, state("running"))),
        (1100, event("ada", 7, 1099, of("task_began"))),
        (1200, body("ada", 6.5)),
        (1400, body("ada", 7.5)),
        (1500, missions("running")),
        (2000, FleetInput::Links(1)),
        (4000, FleetInput::Links(1)),
        (4100, event("s-2", 9, 4090, json!({ "event": "elected", "term": 2, "voters": ["s-2"] }))),
        (4110, beacon("s-2", 2, 20)),
        (4500, world(true, "open")),
        // Three events of ada were lost.
        (5000, event("ada", 11, 4999, of("task_ended"))),
        (5100, event("s-2", 10, 5090, state("completed"))),
        (5200, missions("completed")),
        (9000, FleetInput::Links(0)),
    ]
}

#[test]
fn every_instant_of_a_recording_equals_the_live_model() {
    let live = LiveRecording::record(story());
    let recording = RecordingReader::open(&live.file.0).unwrap();
    assert_eq!((recording.fleet(), recording.from_ms(), recording.to_ms()), ("ward", BEGAN, BEGAN + 9000));
    assert_eq!((recording.damage(), recording.inputs()), (None, story().len()));
    assert_eq!(recording.valid_inputs().count(), story().len());
    for after_ms in [0, 4, 5, 1000, 1150, 1400, 3999, 4000, 4100, 5000, 5199, 9000, 99_000] {
        assert_eq!(&recording.model_at(BEGAN + after_ms).to_json(), live.at(after_ms), "{after_ms} ms");
    }
    // The states must differ.
    let model = |after_ms: u64| recording.model_at(BEGAN + after_ms);
    assert!(model(999).missions().is_empty());
    assert_eq!(model(4099).missions()["m-1"].state, "running");
    assert_eq!(model(9000).missions()["m-1"].state, "completed");
    assert_eq!(model(4099).coordinator().unwrap().node, "s-1");
    assert_eq!(model(4100).coordinator().unwrap().node, "s-2");
    assert_eq!((model(1300).robots()["ada"].x, model(1400).robots()["ada"].x), (6.5, 7.5));
    let places = model(5).to_json()["map"]["places"].clone();
    let names: Vec<&str> = places.as_array().unwrap().iter().filter_map(|place| place["name"].as_str()).collect();
    assert_eq!(names, ["Dock", "IC Room 6"], "the map is that of the fleet");
    assert_eq!(model(1100).log().len(), 3, "events until then");
}

#[test]
fn coordinator_changes_and_mission_ends_are_marked() {
    let live = LiveRecording::record(story());
    let recording = RecordingReader::open(&live.file.0).unwrap();
    let marks: Vec<_> =
        recording.marks().iter().map(|mark| (mark.at_ms - BEGAN, mark.kind, mark.text.as_str())).collect();
    assert_eq!(
        marks,
        [
            (4100, TimelineMarkKind::Coordinator, "coordinator s-2, term 2"),
            (5100, TimelineMarkKind::Completed, "m-1 completed")
        ]
    );
}

/// Any input after any delay.
fn arbitrary_input() -> impl Strategy<Value = (u64, FleetInput)> {
    let name = prop::sample::select(vec!["ada", "bob", "s-1"]);
    let what = (0..10u8, name, 0..60u64).prop_map(|(what, name, number)| match what {
        0 => beacon(name, number / 20 + 1, number),
        1 | 2 => FleetInput::Links(number as usize % 3),
        3 => body(name, number as f64 / 4.0),
        4 => robots(&[name, "cyd"][..(number as usize % 2 + 1)]),
        5 => world(number % 2 == 0, if number % 3 == 0 { "open" } else { "closing" }),
        6 => missions_of(if number > 50 { "completed" } else { "running" }, number % 4),
        7 => event(name, number, number, json!({ "event": "elected", "term": number / 9, "voters": [name] })),
        8 => map(),
        _ => {
            event(name, number, number, json!({ "event": "task_began", "mission": "m-1", "role": "r1", "task": "go" }))
        }
    });
    (prop_oneof![0..30u64, 0..3000u64], what)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn seeking_to_an_instant_equals_playing_up_to_it(
        inputs in prop::collection::vec(arbitrary_input(), 1..400),
        jumps in prop::collection::vec(0.0..1.1f64, 1..20),
    ) {
        let mut now_ms = 0;
        let inputs = inputs.into_iter().map(|(later_ms, input)| {
            now_ms += later_ms;
            (now_ms, input)
        });
        let live = LiveRecording::record(inputs);
        let recording = RecordingReader::open(&live.file.0).unwrap();
        // A single model moves back and forth, as that of the publisher does.
        let (mut model, mut taken) = (recording.initial_model(), 0);
        // The rendered model, and the model of a client that applies the patches.
        let mut drawn = Value::Null;
        model.render_patch(&mut drawn);
        let mut seen = drawn.clone();
        for share in jumps {
            let anywhere_ms = (live.length_ms() as f64 * share) as u64;
            // Mostly the exact instants of inputs.
            let after_ms = if share < 0.7 { live.last_input_ms(anywhere_ms) } else { anywhere_ms };
            taken = recording.seek(&mut model, taken, BEGAN + after_ms);
            prop_assert_eq!(&model.to_json(), live.at(after_ms), "{} ms, after a jump", after_ms);
            if let Some(patch) = model.render_patch(&mut drawn) {
                delta::apply(&mut seen, &patch);
            }
            prop_assert_eq!(&seen, live.at(after_ms), "{} ms, by what has changed", after_ms);
            prop_assert_eq!(&drawn, &seen);
            prop_assert_eq!(&recording.model_at(BEGAN + after_ms).to_json(), live.at(after_ms), "{} ms, at once", after_ms);
        }
    }
}

#[test]
fn keyframes_keep_seeking_fast_in_a_long_recording() {
    // An hour with four inputs per second: keyframes become rarer, and the shown state stays right.
    let inputs = (0..14_400u64).map(|number| (number * 250, body("ada", number as f64 / 4.0)));
    let live = LiveRecording::record(inputs);
    let recording = RecordingReader::open(&live.file.0).unwrap();
    for minute in [0, 59, 1, 30, 29, 31, 58] {
        let after_ms = minute * 60_000 + 100;
        assert_eq!(&recording.model_at(BEGAN + after_ms).to_json(), live.at(after_ms), "minute {minute}");
    }
    const { assert!(KEYFRAMES_MAX < 14_400) };
}
