//! A person whose certificate names missions of the fleet submits these missions, as the fleet defines them, and no
//! other plan under their names.

use crate::closed::served;
use crate::support::{Answer, Closed, example, http};
use serde_json::{Value, json};

const LOOK: &str = r#"
mission: look
title: Look in at a room
parameters: { room: { kind: place } }
roles: { looker: { kind: managed } }
root: { task: look_in, type: navigation, roles: [looker], parameters: { to: "${room}" } }
"#;

const VISIT: &str = r#"{
  "0": { "name": "visits", "type": "task", "parent": "-1", "agents": ["ada", "bob"], "children": ["1"] },
  "1": { "name": "m-visits", "type": "method", "parent": "0", "agents": ["ada", "bob"], "children": ["2", "3"] },
  "2": { "name": "navto", "type": "action", "parent": "1", "agents": ["ada"], "locations": ["IC Room 6"] },
  "3": { "name": "navto", "type": "action", "parent": "1", "agents": ["bob"], "locations": ["IC Room 6"] }
}"#;

/// Starts the station of a fleet with two missions of its own. Returns the fleet and the address of the dashboard.
fn start() -> (Closed, String) {
    let mut file = example("fleet");
    file.insert("bootstrap_expect".to_owned(), 1.into());
    file.insert("missions".to_owned(), vec!["look.yaml", "visit.json"].into());
    let mut closed = Closed::with_fleet(&file);
    for (name, text) in [("look.yaml", LOOK), ("visit.json", VISIT)] {
        std::fs::write(closed.fleet.path(name), text).expect("the folder can be written to");
    }
    let mut station = example("station");
    station.insert("dashboard".to_owned(), "127.0.0.1:0".into());
    closed.start("station", station, &[]);
    let page = served(&mut closed, "station-1", "dashboard: http://");
    (closed, page)
}

#[test]
fn a_right_to_missions_of_the_fleet_allows_no_other_plan() {
    let (mut closed, page) = start();
    closed.cert(&["person", "lee", "--scope", "submit", "--missions", "look,visit"]);
    let certs = closed.of("lee").display().to_string();
    let bearer = format!("Bearer {}", closed.token("lee", &[]));
    let with = |request: &str, body: &str| {
        http(&page, request, &[("Authorization", &bearer), ("Content-Type", "application/json")], body)
    };
    let error = |answer: &Answer| answer.json()["error"].as_str().unwrap_or_default().to_owned();

    let offered = with("GET /api/named-missions", "").json();
    let offered = offered["missions"].as_array().expect("a list").clone();
    let names: Vec<(&Value, &Value)> = offered.iter().map(|one| (&one["mission"], &one["title"])).collect();
    let ihtn = json!("a mission in the flat iHTN form");
    assert_eq!(names, [(&json!("look"), &json!("Look in at a room")), (&json!("visit"), &ihtn)]);
    assert_eq!(offered[0]["parameters"]["room"]["kind"], "place", "{offered:?}");

    let submit = ["submit", "look", "--set", "room=IC Room 6", "--certs", &certs];
    assert_eq!(closed.fleet.run(&submit, "station-1").expect(0).stdout, "look-1\n");
    let shown = closed.fleet.run(&["missions", "look-1", "--json", "--certs", &certs], "station-1").expect(0).stdout;
    assert!(shown.contains("look_in"), "the plan is that of the fleet: {shown}");

    // Another plan under a permitted name, and even a copy of the permitted plan.
    let allowed = "the right `missions` of the certificate allows look, visit, by name";
    let a_file = format!("lee may not submit a mission file: {allowed}");
    for (name, text) in [("attack.yaml", LOOK.replace("look_in", "wander")), ("copy.yaml", LOOK.to_owned())] {
        let path = closed.fleet.path(name);
        std::fs::write(&path, text).expect("the folder can be written to");
        let file = path.display().to_string();
        let submit = ["submit", &file, "--set", "room=IC Room 6", "--certs", &certs];
        let refused = closed.fleet.run(&submit, "station-1").expect(1).stderr;
        assert!(refused.contains(&a_file), "{refused}");
    }
    // Other people make another plan of a flat iHTN, and so would another name.
    let ihtn_file: Value = serde_json::from_str(VISIT).expect("JSON");
    let in_schedule = |submit: &Value| json!({ "action": "add", "cron": "0 8 * * *", "submit": submit }).to_string();
    for (attack, expected) in [
        (json!({ "mission": ihtn_file, "name": "visit" }), a_file.as_str()),
        (json!({ "mission": "visit", "people": ["bob"] }), "`people` belongs to a mission in the flat iHTN form"),
        (json!({ "mission": "visit", "name": "look" }), "`name` belongs to a mission in the flat iHTN form"),
        (json!({ "mission": "vital-signs" }), "lee may not submit \"vital-signs\""),
    ] {
        for refused in
            [with("POST /api/missions", &attack.to_string()), with("POST /api/schedules/daily", &in_schedule(&attack))]
        {
            assert_eq!(refused.status, 400, "{attack}: {}", refused.body);
            assert!(error(&refused).contains(expected), "{attack}: {}", refused.body);
        }
    }
    let taken = with("POST /api/missions", r#"{ "mission": "visit" }"#);
    assert_eq!(taken.json()["mission"], "visit-2", "nothing was submitted before: {}", taken.body);
    let added = with("POST /api/schedules/daily", &in_schedule(&json!({ "mission": "visit" })));
    assert_eq!(added.status, 200, "{}", added.body);

    // A resumed schedule submits its mission again.
    let unrestricted = format!("Bearer {}", closed.token("submit", &[]));
    let change = |bearer: &str, schedule: &str, body: &str| {
        let headers = [("Authorization", bearer), ("Content-Type", "application/json")];
        http(&page, &format!("POST /api/schedules/{schedule}"), &headers, body)
    };
    let (pause, resume) = (r#"{ "action": "pause" }"#, r#"{ "action": "resume" }"#);
    let rounds = in_schedule(&json!({ "mission": "vital-signs" }));
    for (schedule, body) in [("rounds", rounds.as_str()), ("rounds", pause), ("daily", pause)] {
        let changed = change(&unrestricted, schedule, body);
        assert_eq!(changed.status, 200, "{schedule}: {}", changed.body);
    }
    let refused = change(&bearer, "rounds", resume);
    assert_eq!(refused.status, 400, "{}", refused.body);
    assert!(error(&refused).contains("lee may not submit \"vital-signs\""), "{}", refused.body);
    let resumed = change(&bearer, "daily", resume);
    assert_eq!(resumed.status, 200, "{}", resumed.body);

    // The person cancels only missions that it may submit.
    let submits = closed.of("submit").display().to_string();
    let submit = ["submit", "vital-signs", "--certs", &submits];
    let foreign = closed.fleet.run(&submit, "station-1").expect(0).stdout.trim().to_owned();
    let cancel = ["cancel", "look-1", &foreign, "--by", "Lee", "--certs", &certs];
    let canceled = closed.fleet.run(&cancel, "station-1").expect(1);
    assert_eq!(canceled.stdout, "look-1 canceled: by Lee, according to lee\n", "{}", canceled.stderr);
    let why = "only people who may submit a mission change it: lee may not submit \"vital-signs\"";
    assert!(canceled.stderr.contains(&format!("{foreign}: {why}")), "{}", canceled.stderr);
    let listed = ["cancel", "--where", "mission.state == \"pending\"", "--dry-run", "--certs", &certs];
    let listed = closed.fleet.run(&listed, "station-1").expect(1);
    assert_eq!(listed.stdout, "visit-2 would be canceled; it is pending\n", "{}", listed.stderr);
    assert!(listed.stderr.contains(&format!("{foreign}: {why}")), "{}", listed.stderr);

    let refused = closed.fleet.run(&["submit", "lok", "--certs", &submits], "station-1").expect(1).stderr;
    let expected = "the fleet has no mission \"lok\"; allowed: look, visit, bed-transfer, ";
    assert!(refused.contains(expected) && refused.contains("did you mean `look`?"), "{refused}");
    closed.fleet.stop();
}
