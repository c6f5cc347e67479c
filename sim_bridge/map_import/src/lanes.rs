//! Lanes that several entries of a foreign file describe: one for each direction, or for each graph.

use consort_world::map::{Facing, LaneEntry};
use std::collections::BTreeMap;

/// Returns a lane for each pair of neighbours, in the order of the entries, or two one-way lanes if its directions
/// differ. A direction belongs to the graphs of all its entries. Of several speed limits the lowest counts, of several
/// lengths the greatest, and a heading only if no entry contradicts it.
pub(crate) fn join(entries: Vec<LaneEntry>) -> Vec<LaneEntry> {
    let mut order: Vec<(String, String)> = Vec::new();
    let mut directions: BTreeMap<(String, String), LaneEntry> = BTreeMap::new();
    for entry in entries {
        let back = (!entry.one_way).then(|| reversed(&entry));
        let forward = LaneEntry { one_way: true, ..entry };
        for lane in [Some(forward), back].into_iter().flatten() {
            match directions.get_mut(&lane.between) {
                Some(known) => merge(known, lane),
                None => {
                    order.push(lane.between.clone());
                    directions.insert(lane.between.clone(), lane);
                }
            }
        }
    }
    let mut lanes = Vec::new();
    for ends in order {
        let Some(lane) = directions.remove(&ends) else { continue };
        match directions.remove(&(ends.1, ends.0)) {
            Some(back) if reversed(&back) == lane => lanes.push(LaneEntry { one_way: false, ..lane }),
            Some(back) => lanes.extend([lane, back]),
            None => lanes.push(lane),
        }
    }
    lanes
}

/// Returns the opposite direction of a lane, as a one-way lane.
fn reversed(lane: &LaneEntry) -> LaneEntry {
    let facing = lane.facing.map(|facing| match facing {
        Facing::Forward => Facing::Backward,
        Facing::Backward => Facing::Forward,
    });
    let between = (lane.between.1.clone(), lane.between.0.clone());
    LaneEntry { between, one_way: true, facing, ..lane.clone() }
}

/// Adds another entry of the same direction.
fn merge(known: &mut LaneEntry, lane: LaneEntry) {
    // No graphs are all graphs.
    if known.graphs.is_empty() || lane.graphs.is_empty() {
        known.graphs.clear();
    } else {
        known.graphs.extend(lane.graphs);
    }
    let limits = known.speed_limit_mps.into_iter().chain(lane.speed_limit_mps);
    known.speed_limit_mps = limits.reduce(f64::min);
    known.length_m = known.length_m.into_iter().chain(lane.length_m).reduce(f64::max);
    known.facing = known.facing.filter(|facing| lane.facing == Some(*facing));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lane(from: &str, to: &str, one_way: bool, graph: &str) -> LaneEntry {
        let between = (from.to_owned(), to.to_owned());
        LaneEntry { between, one_way, graphs: [graph.to_owned()].into(), ..LaneEntry::default() }
    }

    #[test]
    fn equal_directions_become_a_two_way_lane() {
        let slow = LaneEntry { speed_limit_mps: Some(0.4), ..lane("a", "b", true, "0") };
        let fast = LaneEntry { speed_limit_mps: Some(0.9), ..lane("a", "b", true, "1") };
        let joined = join(vec![fast, slow.clone(), lane("b", "a", true, "0"), lane("b", "c", true, "0")]);
        let both = LaneEntry { graphs: ["0", "1"].map(str::to_owned).into(), ..slow };
        assert_eq!(joined, [both, lane("b", "a", true, "0"), lane("b", "c", true, "0")]);
        let joined = join(vec![lane("a", "b", true, "0"), lane("b", "a", true, "0")]);
        assert_eq!(joined, [lane("a", "b", false, "0")]);
    }
}
