use super::*;
use crate::auction::AuctionId;
use crate::ids::RobotId;
use crate::knowledge::{Knowledge, Record, RecordStamp};
use crate::versions::VersionRange;
use Operation::{Publish, Query, Reply};
use serde::Serialize;

/// Who is tried: a letter, and whose certificate that is.
const BEARERS: [(char, &str); 9] = [
    ('r', "node/ada?roles=robot"),
    ('v', "node/ada?roles=voter"),
    ('h', "node/ada?roles=host"),
    ('n', "node/ada?roles="),
    ('R', "node/bob?roles=robot"),
    ('V', "node/bob?roles=voter"),
    ('H', "node/bob?roles=host"),
    ('N', "node/bob?roles="),
    ('p', "person/ada?scope=operate"),
];

const ANY: &str = "rvhnRVHN";
const ADA: &str = "rvhn";

/// Keys that are about ada, and who may publish, ask and answer on them.
const TABLE: [(&str, [&str; 3]); 34] = [
    ("wire/knowledge/ada", [ADA, "", ""]),
    ("wire/swim/ada", [ANY, "", ""]),
    ("wire/gossip/ada", ["", ANY, ADA]),
    ("wire/card/07070707070707070707070707070707", ["", "", ""]),
    ("wire/raft/0000000000000007/vote", ["", "vV", "vV"]),
    ("wire/found/ada", ["", "vV", "v"]),
    ("wire/found/*", ["", "vV", ""]),
    ("wire/beacon", ["vV", "", ""]),
    ("wire/changed", ["vV", "", ""]),
    ("wire/bid/ada", ["", "vV", "r"]),
    ("wire/bid/*", ["", "vV", ""]),
    ("wire/award/ada", ["", "vV", "r"]),
    ("wire/report/ada", ["", "rhRH", "v"]),
    ("wire/live/ada", ["", ANY, "v"]),
    ("wire/signal/lab-1/r1", ["rhRH", "", ""]),
    ("wire/said/lab-1/r1", ["", ANY, "rhRH"]),
    ("wire/body/ada/command", ["", "r", "hH"]),
    ("wire/body/ada/state", ["hH", "", ""]),
    ("wire/people/ask", ["", "hH", "hH"]),
    ("wire/people/done", ["hH", "", ""]),
    ("wire/world", ["", ANY, "hH"]),
    ("events/ada", [ADA, "", ""]),
    ("view/fleet", ["", "", ANY]),
    ("view/mission/lab-1", ["", "", ANY]),
    ("seen/ada/health", ["", "", ADA]),
    ("seen/ada/mission/lab-1", ["", "", ADA]),
    ("api/submit", ["", "", "vV"]),
    ("api/cancel", ["", "", "vV"]),
    ("api/rescued", ["", "", "vV"]),
    ("api/backup", ["", "", "vV"]),
    ("api/explain", ["", "", ANY]),
    ("api/submit/help", ["", "", ANY]),
    ("api/leave/ada", ["", "", ADA]),
    ("alive/node/ada", ["", "", ""]),
];

fn identity(of: &str) -> Identity {
    format!("consort://ward/{of}").parse().unwrap()
}

fn wire<T: Serialize>(said: &T) -> Vec<u8> {
    codec::encode(said).unwrap()
}

fn within<T: Serialize>(said: &T) -> Vec<u8> {
    wire(&ClusterEnvelope { cluster: None, payload: wire(said) })
}

/// What somebody of this name says on a key, where what is said names its author.
fn said(key: &str, act: Operation, name: &str) -> Option<Vec<u8>> {
    let (node, robot) = (NodeId::new(name).unwrap(), RobotId::new(name).unwrap());
    let (mission, role) = ("lab-1".parse().unwrap(), "r1".parse().unwrap());
    Some(match (key.split('/').nth(1)?, act) {
        ("knowledge", Publish) => {
            let knowledge = Knowledge {
                may_vote: true,
                stationary: false,
                mains_powered: false,
                replica: None,
                cluster: None,
                leaving: false,
                supported_versions: VersionRange::OWN,
                robot: None,
            };
            let record = Record { owner: node, stamp: RecordStamp::default(), knowledge, proof: None };
            codec::encode_for_version(2, RecordUpdate::Record(record)).unwrap()
        }
        ("found", Ask) => wire(&BootstrapRequest { mobile: false, on_battery: false, node }),
        ("beacon", Publish) => {
            within(&Beacon { node, term: 1, voters: BTreeSet::new(), since_ms: 0, cluster: None, wire: None })
        }
        ("changed", Publish) => within(&MissionsChanged { node, term: 1 }),
        ("bid", Answer) => {
            wire(&BidResponse { robot, auction: AuctionId { mission, term: 1, round: 1 }, replies: vec![] })
        }
        ("report", Ask) => within(&Report {
            robot,
            incarnation: 1,
            mission,
            role,
            epoch: Default::default(),
            branch: Default::default(),
            ended: BTreeSet::new(),
            current_task: None,
            place: None,
            from_checkpoint: false,
            failure: None,
        }),
        _ if key.starts_with("events/") => format!(r#"{{"node": "{name}", "sequence": 1}}"#).into_bytes(),
        _ => return None,
    })
}

/// The name in an identity as it stands in [`BEARERS`].
fn name(of: &str) -> &str {
    of.split(['/', '?']).nth(1).unwrap()
}

#[test]
fn everybody_may_say_what_the_table_has_and_nothing_else() {
    for (key, allowed) in TABLE {
        for (act, allowed) in [Publish, Query, Reply].into_iter().zip(allowed) {
            for (letter, of) in BEARERS {
                let payload = said(key, act, name(of)).unwrap_or_default();
                let checked = authorize(&identity(of), act, key, &payload);
                assert_eq!(checked.is_ok(), allowed.contains(letter), "{of} {act:?} {key}: {checked:?}");
            }
        }
    }
}

#[test]
fn whatever_names_its_author_names_its_bearer() {
    let mut tried = 0;
    for (key, allowed) in TABLE {
        for (act, allowed) in [Publish, Query, Reply].into_iter().zip(allowed) {
            for (letter, of) in BEARERS {
                let other = if name(of) == "ada" { "bob" } else { "ada" };
                // Hosts report for people.
                let answers_for_all = key.starts_with("wire/report/") && "hH".contains(letter);
                let Some(payload) = said(key, act, other).filter(|_| allowed.contains(letter) && !answers_for_all)
                else {
                    continue;
                };
                tried += 1;
                let denied = authorize(&identity(of), act, key, &payload).unwrap_err();
                assert!(matches!(&denied, AccessDenied::Impersonation { name, .. } if name == other), "{denied}");
                let denied = authorize(&identity(of), act, key, b"\xff").unwrap_err();
                assert!(matches!(&denied, AccessDenied::Unreadable { .. }), "{denied}");
            }
        }
    }
    assert_eq!(tried, 19, "everybody who may say something on these keys");
}

#[test]
fn what_is_denied_says_who_and_where() {
    let said =
        |of: &str, act, key: &str, payload: &[u8]| authorize(&identity(of), act, key, payload).unwrap_err().to_string();
    assert_eq!(
        said("node/eve?roles=robot", Reply, "api/submit", b"{}"),
        "node eve (robot) may not answer on api/submit"
    );
    let forged = said("node/ada?roles=robot", Publish, "events/ada", br#"{"node": "bob"}"#);
    assert_eq!(forged, "node ada (robot) speaks on events/ada in the name of bob");
}
