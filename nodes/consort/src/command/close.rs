//! `consort close` and `consort open`: close zones, places and lanes, and open them.

use super::change_flags::{ChangeFlags, ReasonFlag};
use super::flag_values::parse_duration;
use super::hold::seconds;
use crate::exit::Failure;
use consort_fleet::recurrence::until_text;
use consort_protocol::api::{CLOSE_S_MAX, CloseRequest, ClosuresReply, OpenRequest};
use consort_protocol::ids::PlaceId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::Closure;
use std::collections::BTreeSet;
use std::time::Duration;

/// Close places or lanes of the map, or zones: no robot enters them
///
/// A robot that drives towards a closed place stops and takes another way, or waits if there is none. A robot inside a
/// closed place may leave it. Robots refuse roles that lead into it until it is open. The fleet keeps closures in its
/// ledger, so the next coordinator repeats them; `consort fleet` lists them. A robot without contact heeds the closures
/// that it has received. This is not a safety function: it depends on the network.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort close 'IC Room 6' --reason 'wet floor'
  consort close 'IC Room 5' 'IC Room 6' --for 2h --by Nia
  consort close --lane 'IC Corridor 5' 'IC Room 5' --until 2026-12-31T18:00:00+01:00
  consort close icu --reason evacuation
  consort open 'IC Room 6'")]
pub(crate) struct CloseArgs {
    #[command(flatten)]
    parts: PartFlags,
    /// The closure ends by itself after this time, as 30m or 2d. Default: no end
    #[arg(long = "for", value_name = "TIME", value_parser = parse_duration, conflicts_with = "until")]
    length: Option<Duration>,
    /// The closure ends by itself at this date and time, as 2026-12-31T18:00:00+01:00
    #[arg(long, value_name = "TIME")]
    until: Option<String>,
    #[command(flatten)]
    reason: ReasonFlag,
    #[command(flatten)]
    change: ChangeFlags,
}

/// Open closed places, lanes or zones
///
/// Places that are not closed stay as they are. A lane stays closed while a place at its end is closed, and a place
/// while a zone with it is closed.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort open 'IC Room 6'
  consort open --lane 'IC Corridor 5' 'IC Room 5' --by Nia")]
pub(crate) struct OpenArgs {
    #[command(flatten)]
    parts: PartFlags,
    #[command(flatten)]
    change: ChangeFlags,
}

/// Flags for the zones, places and lanes.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = true)]
pub(super) struct PartFlags {
    /// Places, as named in the map, or zones, as named in the fleet file
    #[arg(value_name = "PLACE")]
    places: Vec<PlaceId>,
    /// A lane of the map by its two ends; may be repeated
    #[arg(long = "lane", num_args = 2, value_names = ["PLACE", "PLACE"])]
    lanes: Vec<PlaceId>,
}

/// The names of zones and places, and the ends of lanes.
pub(super) struct Places {
    pub(super) places: BTreeSet<PlaceId>,
    pub(super) lanes: Vec<(PlaceId, PlaceId)>,
}

impl PartFlags {
    pub(super) fn places(self) -> Places {
        let lanes = self.lanes.chunks_exact(2).map(|ends| (ends[0].clone(), ends[1].clone())).collect();
        Places { places: self.places.into_iter().collect(), lanes }
    }
}

/// Runs `consort close`.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api); [`Failure::Usage`] if the time is too long.
pub(crate) fn run(args: CloseArgs) -> Result<(), Failure> {
    let CloseArgs { parts, length, until, reason: ReasonFlag { reason }, change } = args;
    let Places { places, lanes } = parts.places();
    let for_s = length.map(|length| seconds(length, CLOSE_S_MAX)).transpose()?;
    let request = |by, request| CloseRequest { places, lanes, for_s, until, reason, by, request };
    change.send(ApiCall::Close, request, reply_text)
}

/// Runs `consort open`.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api).
pub(crate) fn open(args: OpenArgs) -> Result<(), Failure> {
    let OpenArgs { parts, change } = args;
    let Places { places, lanes } = parts.places();
    change.send(ApiCall::Open, |by, request| OpenRequest { places, lanes, by, request }, reply_text)
}

fn reply_text(ClosuresReply { closures }: &ClosuresReply) -> String {
    if closures.is_empty() { "nothing is closed".to_owned() } else { closures_text(closures) }
}

/// Formats closures, a line for each: `IC Room 6 is closed by Nia: wet floor, until 2026-12-31 17:00 UTC`.
pub(super) fn closures_text(closures: &[Closure]) -> String {
    let line =
        |Closure { part, order }: &Closure| format!("{}{}", part.state_text(Some(order)), until_text(order.until_ms));
    closures.iter().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ledger::{MapPart, RobotOrder, Zone};

    #[test]
    fn closures_are_shown_with_their_ends_and_reasons() {
        let place = |name: &str| -> PlaceId { name.parse().unwrap() };
        let order = |reason: &str, until_ms| RobotOrder {
            by: "Nia".to_owned(),
            reason: reason.to_owned(),
            since_ms: 1,
            until_ms,
        };
        let zone = Zone { name: "icu".parse().unwrap(), places: [place("IC Room 5")].into() };
        let closures = [
            Closure { part: MapPart::Zone(zone), order: order("evacuation", None) },
            Closure { part: MapPart::Place(place("IC Room 6")), order: order("", Some(1_767_225_600_000)) },
            Closure { part: MapPart::of_lane(place("B"), place("A")), order: order("wet floor", None) },
        ];
        let expected = "zone icu is closed by Nia: evacuation\nIC Room 6 is closed by Nia, until 2026-01-01 00:00 UTC\n\
                        A – B is closed by Nia: wet floor";
        assert_eq!(closures_text(&closures), expected);
    }
}
