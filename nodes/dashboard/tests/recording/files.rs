//! Recording files: their contents, and files that are truncated, damaged, or of another kind.

use crate::support::*;
use consort_dashboard::fleet_model::FleetInput;
use consort_dashboard::recording::{FLUSH_AFTER, RecordingReader, RecordingWriter};
use consort_world::record::foxglove::ExistingFile;
use mcap::MessageStream;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;

/// Half a minute of driving, with events.
fn driving() -> impl Iterator<Item = (u64, FleetInput)> {
    let words = [(1, map()), (2, robots(&["ada"])), (3, world(false, "closed")), (4, beacon("s-1", 1, 0))];
    let drive = (1..150u64).flat_map(|number| {
        let after_ms = number * 200;
        let progress = json!({ "event": "progress", "mission": "m-1", "done": number, "steps": 150 });
        [(after_ms, body("ada", number as f64 / 8.0)), (after_ms + 50, event("s-1", number, after_ms, progress))]
    });
    words.into_iter().chain(drive)
}

#[test]
fn a_file_has_topics_with_schemas_and_events_with_times() {
    let elected = json!({ "event": "elected", "term": 2, "voters": ["s-2"] });
    let inputs = [
        (5, map()),
        (10, robots(&["ada"])),
        (12, world(false, "closed")),
        (20, beacon("s-1", 1, 500)),
        (30, FleetInput::Links(1)),
        (40, body("ada", 6.5)),
        (100, event("s-2", 9, 90, elected.clone())),
        (200, event("s-2", 12, 195, elected)),
        (250, world(true, "opening")),
    ];
    let live = LiveRecording::record(inputs);
    let recorded = live.recorded;
    assert_eq!((recorded.events, recorded.reports, recorded.views), (2, 1, 4));
    assert_eq!((recorded.gaps, recorded.lost, recorded.seconds), (1, 2, 0.25));
    let bytes = fs::read(&live.file.0).unwrap();
    assert_eq!(recorded.bytes, bytes.len() as u64);
    let summary = mcap::Summary::read(&bytes).unwrap().expect("an index");
    assert_eq!(summary.stats.unwrap().message_count, recorded.messages);
    let messages: Vec<mcap::Message<'_>> = MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    let of = |message: &mcap::Message<'_>| {
        let schema = message.channel.schema.clone().expect("each topic has a schema");
        assert_eq!((schema.encoding.as_str(), message.channel.message_encoding.as_str()), ("jsonschema", "json"));
        let described: Value = serde_json::from_slice(&schema.data).unwrap();
        assert_eq!(described["title"], schema.name.as_str());
        let data: Value = serde_json::from_slice(&message.data).unwrap();
        let required = described["required"].as_array().unwrap();
        let missing: Vec<&Value> =
            required.iter().filter(|field| data.get(field.as_str().unwrap()).is_none()).collect();
        assert!(missing.is_empty(), "{}: {missing:?} in {data}", schema.name);
        (message.channel.topic.clone(), schema.name.clone())
    };
    let topics: BTreeSet<(String, String)> = messages.iter().map(of).collect();
    let scene = "foxglove.SceneUpdate";
    let expected = [
        ("/coordinator", "consort.Beacon"),
        ("/doors", scene),
        ("/events", "consort.Event"),
        ("/gaps", "consort.Gap"),
        ("/links", "consort.Links"),
        ("/log", "foxglove.Log"),
        ("/map", scene),
        ("/people", scene),
        ("/robots", scene),
        ("/robots/ada/body", "consort.Body"),
        ("/robots/ada/pose", "foxglove.PoseInFrame"),
        ("/tf", "foxglove.FrameTransforms"),
        ("/view/fleet", "consort.View"),
        ("/view/map", "consort.View"),
        ("/view/world", "consort.View"),
    ];
    assert_eq!(topics, expected.map(|(topic, schema)| (topic.to_owned(), schema.to_owned())).into());

    let on = |topic: &str| messages.iter().filter(|message| message.channel.topic == topic).collect::<Vec<_>>();
    let ns = |after_ms: u64| (BEGAN + after_ms) * 1_000_000;
    let events: Vec<_> = on("/events").iter().map(|one| (one.sequence, one.log_time, one.publish_time)).collect();
    assert_eq!(events, [(9, ns(100), ns(90)), (12, ns(200), ns(195))]);
    let gap: Value = serde_json::from_slice(&on("/gaps")[0].data).unwrap();
    assert_eq!(gap, json!({ "node": "s-2", "after": 9, "before": 12, "lost": 2 }));
    // Unchanged values are not written again; a person that left is removed.
    let counts: BTreeMap<&str, usize> =
        ["/robots", "/tf", "/people", "/doors"].map(|topic| (topic, on(topic).len())).into();
    assert_eq!(counts, [("/robots", 1), ("/tf", 2), ("/people", 2), ("/doors", 3)].into());
    let people: Value = serde_json::from_slice(&on("/people")[1].data).unwrap();
    assert_eq!((&people["deletions"][0]["id"], &people["entities"]), (&json!("Nia"), &json!([])));
    let frame: Value = serde_json::from_slice(&on("/tf")[1].data).unwrap();
    assert_eq!(frame["transforms"][0]["translation"]["x"], 6.5);
}

#[test]
fn a_repeated_view_is_written_once() {
    let again = |from_ms: u64| (0..100u64).map(move |second| (from_ms + second * 1000, missions_of("running", second)));
    let live = LiveRecording::record(again(0).chain([(100_500, missions("completed"))]).chain(again(101_000)));
    let bytes = fs::read(&live.file.0).unwrap();
    let on = |topic: &str| {
        let messages = MessageStream::new(&bytes).unwrap().map(Result::unwrap);
        messages.filter(|message| message.channel.topic == topic).count()
    };
    assert_eq!((on("/view/missions"), on("/view/again"), live.recorded.views), (3, 198, 201));
    let recording = RecordingReader::open(&live.file.0).unwrap();
    for after_ms in [0, 999, 1000, 57_000, 100_000, 100_500, 101_000, 163_000, 200_000] {
        assert_eq!(&recording.model_at(BEGAN + after_ms).to_json(), live.at(after_ms), "{after_ms} ms");
    }
    assert_ne!(live.at(1000), live.at(57_000), "its age is another");
}

#[test]
fn a_truncated_file_is_shown_up_to_the_cut() {
    let live = LiveRecording::record(driving());
    let whole = fs::read(&live.file.0).unwrap();
    assert_eq!(RecordingReader::open(&live.file.0).unwrap().damage(), None);
    let (mut shown, mut refused, mut least_shown) = (0, 0, whole.len());
    for share in (0..100).map(|part| whole.len() * part / 100).chain([9, whole.len() - 1]) {
        let cut = Scratch::holding(&whole[..share]);
        match RecordingReader::open(&cut.0) {
            Ok(recording) => {
                shown += 1;
                least_shown = least_shown.min(share);
                let problem = recording.damage().expect("the damage is reported");
                assert!(problem.contains("it has no end"), "{share}: {problem}");
                let after_ms = recording.to_ms() - BEGAN;
                // The inputs of an instant may be separated by the cut.
                let sure_ms = after_ms.saturating_sub(1);
                assert_eq!(&recording.model_at(BEGAN + sure_ms).to_json(), live.at(sure_ms), "cut at {share}");
            }
            Err(problem) => {
                refused += 1;
                let (problem, name) = (problem.to_string(), cut.0.display().to_string());
                // The schemas and the first instant are missing.
                assert!(problem.starts_with(&name) && share < least_shown, "{share}: {problem}");
            }
        }
    }
    assert!(shown > 70 && refused > 1, "{shown} shown, {refused} refused");
}

#[test]
fn a_damaged_file_is_shown_up_to_the_damage_and_never_wrongly() {
    let live = LiveRecording::record(driving());
    let whole = fs::read(&live.file.0).unwrap();
    let (mut noticed, mut harmless) = (0, 0);
    for part in 1..200 {
        let mut bytes = whole.clone();
        bytes[whole.len() * part / 200] ^= 0x5a;
        let file = Scratch::holding(&bytes);
        let Ok(recording) = RecordingReader::open(&file.0) else {
            noticed += 1;
            continue;
        };
        let sure_ms = match recording.damage() {
            Some(_) => (recording.to_ms() - BEGAN).saturating_sub(1),
            // The damage is in the index, which repeats earlier content.
            None => live.length_ms(),
        };
        *(if recording.damage().is_some() { &mut noticed } else { &mut harmless }) += 1;
        assert_eq!(&recording.model_at(BEGAN + sure_ms).to_json(), live.at(sure_ms), "damaged at part {part}");
    }
    assert!(noticed > 100 && harmless > 10, "{noticed} noticed, {harmless} harmless");
}

#[test]
fn flushed_inputs_survive_a_kill_of_the_recorder() {
    let file = Scratch::new();
    let mut writer = recorder(&file.0, ExistingFile::Keep);
    let mut model = consort_dashboard::fleet_model::FleetModel::new("ward", "recorder", Default::default(), BEGAN);
    let chunk_ms = FLUSH_AFTER.as_millis() as u64;
    for (after_ms, input) in driving() {
        let now_ms = BEGAN + after_ms;
        model.apply(&input, now_ms);
        writer.write_input(&input, &model, now_ms).unwrap();
        writer.flush_due(now_ms).unwrap();
        if after_ms > 2 * chunk_ms {
            // The current content of the disk.
            let left = Scratch::holding(&fs::read(&file.0).unwrap());
            let recording = RecordingReader::open(&left.0).unwrap();
            assert!(recording.to_ms() + chunk_ms >= now_ms, "{} of {now_ms}", recording.to_ms());
        }
    }
}

#[test]
fn an_existing_file_is_kept_unless_replacement_is_requested() {
    let file = Scratch::holding(b"dear diary");
    let kept = RecordingWriter::create(&file.0, ExistingFile::Keep, &fleet(), "recorder", BEGAN);
    let problem = kept.err().expect("it is refused").to_string();
    assert!(problem.starts_with(&format!("{}: the recording cannot be written: ", file.0.display())), "{problem}");
    assert_eq!(fs::read(&file.0).unwrap(), b"dear diary");
    recorder(&file.0, ExistingFile::Replace).finish().unwrap();
    assert_ne!(fs::read(&file.0).unwrap(), b"dear diary");
}

#[test]
fn a_file_of_another_kind_is_rejected_with_its_kind() {
    let refusal = |bytes: &[u8]| {
        let file = Scratch::holding(bytes);
        let problem = RecordingReader::open(&file.0).err().expect("it is refused").to_string();
        problem.strip_prefix(&format!("{}: ", file.0.display())).expect("the file is named").to_owned()
    };
    assert!(refusal(b"").starts_with("this is not an MCAP file"));
    assert!(refusal(b"abc").starts_with("this is not an MCAP file"));
    assert!(refusal(b"%PDF-1.7 and whatever follows").starts_with("this is not an MCAP file"));
    assert!(refusal(mcap::MAGIC).starts_with("this recording cannot be shown: it has no end"));
    // A file of another program.
    let mut writer = mcap::Writer::new(std::io::Cursor::new(vec![])).unwrap();
    let schema = writer.add_schema("foxglove.Log", "jsonschema", b"{}").unwrap();
    writer.add_channel(schema, "/rosout", "json", &BTreeMap::new()).unwrap();
    writer.finish().unwrap();
    let others = refusal(writer.into_inner().get_ref());
    assert!(others.contains("not a recording of a fleet") && others.ends_with("it has the topics /rosout"), "{others}");
    // A recording without any input.
    let file = Scratch::new();
    recorder(&file.0, ExistingFile::Keep).finish().unwrap();
    assert!(refusal(&fs::read(&file.0).unwrap()).contains("no messages were received while it was made"));
    let nowhere = RecordingReader::open("/no/such/run.mcap".as_ref()).err().unwrap().to_string();
    assert!(nowhere.starts_with("/no/such/run.mcap: this recording cannot be read: No such file"), "{nowhere}");
}
