//! Ids of requests that state the time at which they were created. The fleet recognises a repetition by this time after it has
//! forgotten the outcome, and refuses it.

use super::dates::date_ms;
use consort_protocol::ids::RequestId;
use std::hash::{DefaultHasher, Hasher};
use std::time::Duration;

/// Returns an id for the request of this name in the schedule, which is first sent at this time since the start of the run.
pub(super) fn dated_id(name: &str, elapsed: Duration) -> RequestId {
    id_at(name, date_ms(elapsed))
}

/// Checks whether an id is that of the request of this name in the schedule.
pub(super) fn is_named(id: &RequestId, name: &str) -> bool {
    id.as_str() == name || id.created_ms().is_some_and(|created_ms| id_at(name, created_ms) == *id)
}

/// Returns the id with this time of creation. Its other bits follow from the name.
fn id_at(name: &str, created_ms: u64) -> RequestId {
    let mut hasher = DefaultHasher::new();
    hasher.write(name.as_bytes());
    RequestId::generate(created_ms, hasher.finish().into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::dates::DATE_MS;
    use crate::slug;

    #[test]
    fn an_id_states_its_time_and_stands_for_its_name_alone() {
        let [one, later] = [20, 21].map(|at_s| dated_id("b0", Duration::from_secs(at_s)));
        assert_eq!(one.created_ms(), Some(DATE_MS + 20_000));
        assert_ne!(one, later);
        assert!(is_named(&one, "b0") && is_named(&later, "b0") && !is_named(&one, "b1"));
        assert!(is_named(&slug("b0"), "b0") && !is_named(&slug("b0"), "b1"));
    }
}
