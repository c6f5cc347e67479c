//! MCAP files for Foxglove.

use super::*;
use consort_world::record::foxglove::CHUNK_S;
use consort_world::world::Obstacle;
use mcap::MessageStream;
use mcap::read::Options as ReadOptions;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

fn onto(mcap: &TempFile) -> RecordingOutputs {
    RecordingOutputs { mcap: Some(mcap.0.clone()), svg: None }
}

struct Message {
    topic: String,
    schema: String,
    described: Value,
    time_s: f64,
    data: Value,
}

fn messages(bytes: &[u8]) -> Vec<Message> {
    let whole_or_not = ReadOptions::IgnoreEndMagic.into();
    let read = MessageStream::new_with_options(bytes, whole_or_not).unwrap().map_while(Result::ok);
    let message = |message: mcap::Message| {
        let schema = message.channel.schema.clone().unwrap();
        assert_eq!((schema.encoding.as_str(), message.channel.message_encoding.as_str()), ("jsonschema", "json"));
        Message {
            topic: message.channel.topic.clone(),
            schema: schema.name.clone(),
            described: serde_json::from_slice(&schema.data).unwrap(),
            time_s: message.log_time as f64 / 1e9,
            data: serde_json::from_slice(&message.data).unwrap(),
        }
    };
    read.map(message).collect()
}

#[test]
fn a_recording_has_foxglove_topics_in_order_of_time() {
    let file = TempFile::named("topics.mcap");
    let mut world = hall();
    record(&world, &onto(&file));
    run_one_minute(&mut world);
    let said = world.end_recording();
    assert!(said[0].as_ref().unwrap().ends_with("messages, 60 s of world time"), "{said:?}");
    let bytes = fs::read(&file.0).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().expect("an index");
    let messages = messages(&bytes);
    assert_eq!(summary.stats.unwrap().message_count, messages.len() as u64);
    let topics: BTreeSet<(&str, &str)> = messages.iter().map(|m| (m.topic.as_str(), m.schema.as_str())).collect();
    let scene = "foxglove.SceneUpdate";
    let expected = [
        ("/doors", scene),
        ("/log", "foxglove.Log"),
        ("/map", scene),
        ("/people", scene),
        ("/robots", scene),
        ("/robots/ada/pose", "foxglove.PoseInFrame"),
        ("/robots/ada/state", "consort.RobotState"),
        ("/robots/bob/pose", "foxglove.PoseInFrame"),
        ("/robots/bob/state", "consort.RobotState"),
        ("/tf", "foxglove.FrameTransforms"),
    ];
    assert_eq!(topics, expected.into());
    assert!(messages.windows(2).all(|pair| pair[0].time_s <= pair[1].time_s));
    let once = ["/map", "/robots"].map(|topic| messages.iter().filter(|m| m.topic == topic).count());
    assert_eq!(once, [1, 1]);
}

#[test]
fn every_message_conforms_to_its_schema() {
    let file = TempFile::named("schemas.mcap");
    let mut world = hall();
    record(&world, &onto(&file));
    let trolley = Obstacle::between("trolley", place("B"), place("C"));
    world.with(|world| world.add_obstacle(&trolley)).unwrap();
    run_one_minute(&mut world);
    world.with(|world| world.remove_obstacle("trolley"));
    world.end_recording();
    let messages = messages(&fs::read(&file.0).unwrap());
    assert!(messages.iter().any(|m| m.topic == "/obstacles" && m.data["entities"][0]["id"] == "trolley"));
    assert!(messages.iter().any(|m| m.topic == "/obstacles" && m.data["deletions"][0]["id"] == "trolley"));
    for message in &messages {
        assert_eq!(message.described["title"], message.schema.as_str());
        conforms(&message.data, &message.described, &message.topic);
    }
}

/// Checks that a value has exactly the fields of its schema, with their types.
fn conforms(value: &Value, schema: &Value, at: &str) {
    let fits = match schema["type"].as_str().unwrap() {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_u64(),
        "number" => value.is_number(),
        other => panic!("{at}: {other}"),
    };
    assert!(fits, "{at}: {value} is no {}", schema["type"]);
    if let Some(fields) = value.as_object() {
        let named = schema["properties"].as_object().unwrap();
        assert_eq!(fields.keys().collect::<BTreeSet<_>>(), named.keys().collect::<BTreeSet<_>>(), "{at}");
        fields.iter().for_each(|(name, field)| conforms(field, &named[name], &format!("{at}/{name}")));
    }
    for (index, item) in value.as_array().into_iter().flatten().enumerate() {
        conforms(item, &schema["items"], &format!("{at}[{index}]"));
    }
}

#[test]
fn recorded_poses_equal_those_of_an_unrecorded_world() {
    let file = TempFile::named("poses.mcap");
    let mut world = hall();
    record(&world, &onto(&file));
    run_one_minute(&mut world);
    world.end_recording();
    let mut other = hall();
    there_and_back(&mut other);
    let mut seen = 0;
    for message in messages(&fs::read(&file.0).unwrap()).iter().filter(|m| m.topic == "/robots/ada/pose") {
        other.advance(at(message.time_s));
        let pose = other.telemetry(&robot("ada")).unwrap().pose;
        let (position, orientation) = (&message.data["pose"]["position"], &message.data["pose"]["orientation"]);
        let number = |value: &Value| value.as_f64().unwrap();
        let yaw = 2.0 * number(&orientation["z"]).atan2(number(&orientation["w"]));
        let off = [number(&position["x"]) - pose.x, number(&position["y"]) - pose.y, (yaw - pose.yaw).sin()];
        assert!(off.iter().all(|off| off.abs() < 1e-6), "at {} s: {off:?}", message.time_s);
        seen += 1;
    }
    assert!(seen > 300, "{seen}: ten a second while it drives");
}

#[test]
fn nothing_is_written_without_events() {
    let file = TempFile::named("rest.mcap");
    let mut world = hall();
    record(&world, &onto(&file));
    run_one_minute(&mut world);
    for step in 1..=100 {
        world.advance(at(60.0 + 36.0 * f64::from(step)));
    }
    world.end_recording();
    let bytes = fs::read(&file.0).unwrap();
    let times: Vec<f64> = messages(&bytes).iter().map(|message| message.time_s).collect();
    let ended = times.iter().copied().fold(0.0, f64::max);
    assert!((40.0..60.0).contains(&ended), "{ended}");
}

#[test]
fn a_killed_recording_lacks_only_its_last_seconds() {
    let file = TempFile::named("killed.mcap");
    let mut world = hall();
    record(&world, &onto(&file));
    there_and_back(&mut world);
    for step in 1..=40 {
        world.advance(at(f64::from(step) * 0.5));
    }
    // The file as it is on the disk if the process is killed now.
    let killed = fs::read(&file.0).unwrap();
    world.end_recording();
    let whole = messages(&fs::read(&file.0).unwrap());
    assert!(mcap::Summary::read(&killed).is_err(), "it has no end");
    let left = messages(&killed);
    let expected = whole.iter().filter(|message| message.time_s <= 20.0 - CHUNK_S).count();
    assert!(left.len() >= expected && expected > 100, "{} of {}, {expected} expected", left.len(), whole.len());
    assert!(left.iter().zip(&whole).all(|(left, whole)| left.data == whole.data));
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let bytes = ["first.mcap", "second.mcap"].map(|name| {
        let file = TempFile::named(name);
        let mut world = hall();
        record(&world, &onto(&file));
        run_one_minute(&mut world);
        world.end_recording();
        fs::read(&file.0).unwrap()
    });
    assert!(bytes[0] == bytes[1]);
}

#[test]
fn a_failing_recording_names_its_file_and_leaves_the_world_alone() {
    let nowhere = RecordingOutputs { mcap: Some("/no/such/folder/run.mcap".into()), svg: None };
    let problem = Recorder::open(&nowhere).err().unwrap().to_string();
    assert!(problem.starts_with("/no/such/folder/run.mcap: the recording cannot be written: "), "{problem}");
    let full = Path::new("/dev/full");
    if !full.exists() {
        return;
    }
    let mut world = hall();
    record(&world, &RecordingOutputs { mcap: Some(full.to_owned()), svg: None });
    run_one_minute(&mut world);
    assert_eq!(world.telemetry(&robot("ada")).unwrap().place, place("B"), "it drove on");
    let said = world.end_recording();
    assert!(matches!(&said[..], [Err(problem)] if problem.file == full), "{said:?}");
}
