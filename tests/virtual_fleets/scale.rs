//! Measurements of fleets by size (`consort-lab bench scale`).

use consort_skills::domain_file::DomainFile;
use consort_skills::extensions::Extensions;
use consort_tests::scale::{CommitSetup, ScaleFigures, ScaleSetup, measure, measure_commits};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

fn figures(robots: usize, moving: bool) -> ScaleFigures {
    measure(ScaleSetup { robots, moving, missions: 2, backlog: 0, seed: 1, extensions: Extensions::default() }, |_| ())
}

#[test]
fn the_figures_of_a_fleet_follow_from_its_size() {
    let (small, moving, again) = (figures(4, false), figures(8, true), figures(8, true));
    // The call for bids reaches the robots and the arm, and each replies.
    assert!(small.messages_per_auction >= 10.0, "{small:?}");
    assert!(moving.messages_per_auction > small.messages_per_auction, "{small:?} {moving:?}");
    assert!(moving.robot_received_bytes_per_s > small.robot_received_bytes_per_s, "{small:?} {moving:?}");
    assert!(small.records_per_node >= 8.0, "{small:?}");
    for figures in [&small, &moving] {
        let takeover = figures.takeover_ms.expect("takeovers were measured");
        assert!(takeover.p50 > 10.0 && takeover.p50 < 2000.0, "{figures:?}");
        assert!(figures.auction_ms.expect("auctions were measured").p50 > 1.0, "{figures:?}");
        assert!(figures.join_bytes > 1000, "{figures:?}");
        assert!(figures.coordinator_cpu_percent > 0.0, "{figures:?}");
        assert!(figures.view_ms.expect("views were measured").p50 > 0.0, "{figures:?}");
    }
    assert_eq!(moving.trace, again.trace);
    assert_eq!(moving.takeover_ms, again.takeover_ms);
}

#[test]
fn commits_are_measured_among_waiting_missions() {
    let figures = measure_commits(CommitSetup { missions: 20, history: 3, seed: 1 }, |_| ());
    let commit = figures.commit_ms.expect("commits were measured");
    assert_eq!((figures.missions, figures.commits), (20, 400));
    assert!(commit.p50 > 0.5 && commit.p999 < 1000.0, "{figures:?}");
    assert!(figures.coordinator_ms.is_some_and(|ms| ms > 0.0 && ms < commit.p50), "{figures:?}");
    assert!(figures.mission_bytes > 100.0 && figures.mission_bytes < 8192.0, "{figures:?}");
    assert!(figures.copy_ms > 0.0 && figures.idle_percent > 0.0, "{figures:?}");
}

#[test]
fn auctions_are_measured_while_a_backlog_waits() {
    let extensions = Extensions::default();
    let figures =
        measure(ScaleSetup { robots: 2, moving: false, missions: 2, backlog: 3, seed: 1, extensions }, |_| ());
    assert_eq!(figures.backlog, 3);
    // Two robots and the arm are called and reply for a mission, and again for those that wait.
    assert!(figures.messages_per_auction > 6.0, "{figures:?}");
    assert!(figures.auction_ms.zip(figures.commit_ms).is_some(), "{figures:?}");
}

#[test]
fn readings_of_a_domain_are_part_of_the_traffic() {
    let reading = json!({ "type": "text", "simulate": { "value": "x".repeat(100) } });
    let readings: Map<String, Value> = (0..20).map(|number| (format!("r{number}"), reading.clone())).collect();
    let form = serde_json::from_value(json!({ "domain": "sensors", "readings": readings })).unwrap();
    let domain = DomainFile::check(form, &BTreeMap::new(), &[]).unwrap();
    let setup =
        ScaleSetup { robots: 2, moving: false, missions: 0, backlog: 0, seed: 1, extensions: Extensions::default() };
    let extensions = Extensions::default().with_domain("sensors.yaml", domain);
    let (plain, with_readings) = (measure(setup, |_| ()), measure(ScaleSetup { extensions, ..setup }, |_| ()));
    let received = |figures: &ScaleFigures| figures.robot_received_bytes_per_s;
    assert!(received(&with_readings) > received(&plain) + 100.0, "{with_readings:?} {plain:?}");
}
