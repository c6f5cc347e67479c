//! Conditions by which people select missions.

use super::entry::MissionEntry;
use crate::ensemble::{Condition, Variables, context_of};
use cel::SerializationError;
use serde::Serialize;
use std::collections::BTreeMap;

/// Compiled condition on a mission, such as `mission.name == "vital-signs" && mission.age_s > 3600`.
#[derive(Debug)]
pub struct MissionFilter(Condition);

/// Fields of a mission in conditions.
#[derive(Serialize)]
struct MissionFacts<'a> {
    id: &'a str,
    name: &'a str,
    /// As in the views.
    state: &'a str,
    priority: i8,
    /// Person or client that asked for it.
    by: &'a str,
    /// Time since its submission.
    age_s: i64,
    parameters: &'a BTreeMap<String, String>,
    /// Robots that hold, have completed or will get a role.
    robots: Vec<&'a str>,
}

impl MissionFilter {
    /// Compiles a condition.
    ///
    /// # Errors
    /// Description of the problem: the text is not an expression, it is too long or too complex, or it uses an unknown
    /// name.
    pub fn compile(text: &str) -> Result<MissionFilter, String> {
        let example = MissionFacts {
            id: "rounds-1",
            name: "rounds",
            state: "pending",
            priority: 0,
            by: "Nia",
            age_s: 0,
            parameters: &BTreeMap::new(),
            robots: vec![],
        };
        let example = variables(&example).expect("the example can be converted");
        Condition::compile(text, &example).map(MissionFilter)
    }

    /// Checks whether the condition is true for a mission at a time in milliseconds since 1970. It is not if it has no
    /// value, for example because the mission lacks a parameter.
    pub fn matches(&self, entry: &MissionEntry, now_ms: u64) -> bool {
        let age_s = now_ms.saturating_sub(entry.submission.at_ms) / 1000;
        let robots = entry.role_robots();
        let facts = MissionFacts {
            id: entry.id.as_str(),
            name: entry.submission.mission.name.as_str(),
            state: entry.state.as_str(),
            priority: entry.submission.priority.get(),
            by: &entry.submission.by,
            age_s: i64::try_from(age_s).unwrap_or(i64::MAX),
            parameters: &entry.submission.parameters,
            robots: robots.values().map(|holder| holder.robot.as_str()).collect(),
        };
        variables(&facts).is_ok_and(|variables| self.0.holds(&context_of(variables)).unwrap_or(false))
    }
}

fn variables(facts: &MissionFacts<'_>) -> Result<Variables, SerializationError> {
    Ok(vec![("mission", cel::to_value(facts)?)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lease::Epoch;
    use crate::ledger::test_values::rounds;
    use crate::ledger::{Command, CommandOutcome, Ledger, Priority, Submission};

    /// Returns a ledger with the mission `rounds-1`, submitted at 1 s.
    fn ledger() -> Ledger {
        let submission = Submission {
            by: "Nia".to_owned(),
            priority: Priority::new(-3).unwrap(),
            parameters: BTreeMap::from([("room".to_owned(), "IC Room 6".to_owned())]),
            at_ms: 1_000,
            ..rounds("one")
        };
        let mut ledger = Ledger::default();
        let outcome = ledger.apply(Epoch { term: 1, index: 1 }, Command::Submit(Box::new(submission)));
        assert!(matches!(outcome, CommandOutcome::Submitted { .. }), "{outcome:?}");
        ledger
    }

    #[test]
    fn a_condition_uses_the_terms_the_state_and_the_age_of_a_mission() {
        let ledger = ledger();
        let entry = ledger.mission(&"rounds-1".parse().unwrap()).unwrap();
        for (text, matches) in [
            (r#"mission.name == "rounds""#, true),
            (r#"mission.id == "rounds-2""#, false),
            (r#"mission.state == "pending" && mission.by == "Nia""#, true),
            ("mission.priority < 0", true),
            ("mission.priority >= 0", false),
            ("mission.age_s >= 60", true),
            ("mission.age_s > 60", false),
            (r#"mission.parameters.room.startsWith("IC ")"#, true),
            (r#"mission.parameters.bed == "7""#, false),
            (r#"!("ada" in mission.robots)"#, true),
        ] {
            let filter = MissionFilter::compile(text).unwrap_or_else(|problem| panic!("{text}: {problem}"));
            assert_eq!(filter.matches(entry, 61_500), matches, "{text}");
        }
    }

    #[test]
    fn an_invalid_condition_is_rejected_when_it_is_compiled() {
        for (text, part) in [
            ("mission.priority <", "ERROR"),
            ("mission.prio < 0", "`mission` has no field `prio`"),
            ("robot.battery > 0.5", "there is no variable `robot`; allowed: `mission`"),
            ("mission.priority", "it must be true or false"),
        ] {
            let problem = MissionFilter::compile(text).unwrap_err();
            assert!(problem.contains(part), "{text}: {problem}");
        }
    }
}
