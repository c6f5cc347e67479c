//! The time of day that a majority of the voters confirms: a single wrong clock does not decide
//! about deadlines.

use consort_protocol::ids::NodeId;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Interval at which the clocks of the voters are read.
const READ_INTERVAL: Duration = Duration::from_secs(5);

/// Interval while no majority is known.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);

/// Age at which a reading is forgotten.
const READING_AGE_MAX: Duration = Duration::from_secs(30);

/// Latest readings of the clocks of other voters.
#[derive(Debug, Default)]
pub(super) struct VoterClocks {
    readings: BTreeMap<NodeId, Reading>,
    asked_at: Option<NodeTime>,
}

#[derive(Debug)]
struct Reading {
    /// Milliseconds since 1970.
    wall_ms: u64,
    /// Arrival of the reading, which was taken before.
    at: NodeTime,
}

impl Reading {
    /// Returns the time that the clock shows now, at least.
    fn wall_ms(&self, now: NodeTime) -> u64 {
        self.wall_ms.saturating_add(now.since(self.at).as_millis().try_into().unwrap_or(u64::MAX))
    }
}

impl VoterClocks {
    /// Checks whether the clocks must be read, and records that they are.
    pub(super) fn begin_reading(&mut self, is_confirmed: bool, now: NodeTime) -> bool {
        let interval = if is_confirmed { READ_INTERVAL } else { RETRY_INTERVAL };
        let is_due = self.asked_at.is_none_or(|asked| now.since(asked) >= interval);
        if is_due {
            self.asked_at = Some(now);
        }
        is_due
    }

    /// Records a reading that has arrived now.
    pub(super) fn record(&mut self, voter: NodeId, wall_ms: u64, now: NodeTime) {
        self.readings.insert(voter, Reading { wall_ms, at: now });
        self.readings.retain(|_, reading| now.since(reading.at) < READING_AGE_MAX);
    }

    /// Returns the latest time, in milliseconds since 1970, that the clocks of a majority of the
    /// voters have reached; `None` if too few readings are known. `own_ms` is the time of this
    /// node's clock, which counts if the node is a voter.
    pub(super) fn confirmed_ms(
        &self,
        voters: &BTreeSet<NodeId>,
        own: &NodeId,
        own_ms: u64,
        now: NodeTime,
    ) -> Option<u64> {
        let is_recent = |reading: &&Reading| now.since(reading.at) < READING_AGE_MAX;
        let time = |voter: &NodeId| match voter == own {
            true => Some(own_ms),
            false => self.readings.get(voter).filter(is_recent).map(|reading| reading.wall_ms(now)),
        };
        let mut times: Vec<u64> = voters.iter().filter_map(time).collect();
        times.sort_unstable_by(|a, b| b.cmp(a));
        times.get(voters.len() / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY: u64 = 86_400_000;

    fn at(seconds: u64) -> NodeTime {
        NodeTime::at(Duration::from_secs(seconds))
    }

    fn nodes(names: &[&str]) -> BTreeSet<NodeId> {
        names.iter().map(|name| name.parse().unwrap()).collect()
    }

    /// Returns the time that the voters ada (this node), bob and eve confirm.
    fn confirmed([ada, bob, eve]: [u64; 3]) -> Option<u64> {
        let mut clocks = VoterClocks::default();
        clocks.record("bob".parse().unwrap(), bob, at(0));
        clocks.record("eve".parse().unwrap(), eve, at(0));
        clocks.confirmed_ms(&nodes(&["ada", "bob", "eve"]), &"ada".parse().unwrap(), ada, at(0))
    }

    #[test]
    fn a_single_wrong_clock_decides_nothing() {
        for wrong in [0, 10 * DAY] {
            let times = [[wrong, DAY, DAY + 30], [DAY, wrong, DAY + 30], [DAY + 30, DAY, wrong]].map(confirmed);
            assert!(times.iter().flatten().all(|time| (DAY..=DAY + 30).contains(time)), "{times:?}");
        }
    }

    #[test]
    fn a_time_needs_recent_readings_of_a_majority() {
        let (ada, voters) = ("ada".parse().unwrap(), nodes(&["ada", "bob", "eve", "fay"]));
        let mut clocks = VoterClocks::default();
        clocks.record("bob".parse().unwrap(), 5_000, at(10));
        assert_eq!(clocks.confirmed_ms(&voters, &ada, 6_000, at(10)), None, "2 of 4");
        clocks.record("zoe".parse().unwrap(), 7_000, at(10));
        assert_eq!(clocks.confirmed_ms(&voters, &ada, 6_000, at(10)), None, "not a voter");
        clocks.record("eve".parse().unwrap(), 5_500, at(11));
        assert_eq!(clocks.confirmed_ms(&voters, &ada, 9_000, at(12)), Some(6_500), "eve's, a second later");
        assert_eq!(clocks.confirmed_ms(&voters, &ada, 9_000, at(40)), None, "bob's is too old");
        assert_eq!(clocks.confirmed_ms(&nodes(&["ada"]), &ada, 6_000, at(40)), Some(6_000));
    }

    #[test]
    fn clocks_are_read_more_often_until_a_majority_is_known() {
        let mut clocks = VoterClocks::default();
        assert!(clocks.begin_reading(false, at(0)) && !clocks.begin_reading(false, at(0)));
        assert!(clocks.begin_reading(false, at(1)) && !clocks.begin_reading(true, at(5)));
        assert!(clocks.begin_reading(true, at(6)));
    }
}
