//! What is wrong with a design, each with its key.

use super::{Design, Scenario, UniformRange};
use crate::map::Map;
use crate::suggest::did_you_mean;
use crate::world::STOPPING_SHARE;
use consort_protocol::ids::{PlaceId, RoleId};
use consort_protocol::mission::{Domain, Mission, RoleKind, shipped};
use std::collections::{BTreeMap, BTreeSet};

/// Most levels of a factor: they are named by letters.
const LEVELS_MAX: usize = 26;

/// Most robots that drive.
const ROBOTS_MAX: usize = 99;

/// Most trials of a design.
const TRIALS_MAX: usize = 1_000_000;

impl Design {
    /// All that is wrong with it beyond its form. Places are looked for by [`misplaced`](Design::misplaced).
    pub fn validation_errors(&self) -> Vec<String> {
        let mut problems = vec![];
        let mut check = |sound: bool, problem: String| {
            if !sound {
                problems.push(problem);
            }
        };
        let slug = RoleId::new(self.name.as_str()).map(|_| ()).map_err(|error| error.to_string());
        check(slug.is_ok(), format!("name: {}", slug.err().unwrap_or_default()));
        check(self.repetitions > 0, "repetitions: is 0, allowed is 1 or more".to_owned());
        check(!self.policies.is_empty(), "policies: is empty, allowed is one or more".to_owned());
        check(!self.treatments.is_empty(), "treatments: is empty, allowed is one or more".to_owned());
        let distinct: BTreeSet<_> = self.policies.iter().collect();
        check(distinct.len() == self.policies.len(), "policies: one is named twice".to_owned());
        let distinct: BTreeSet<_> = self.treatments.iter().collect();
        check(distinct.len() == self.treatments.len(), "treatments: one is named twice".to_owned());
        let number = |key: &str, value: f64, least: f64, most: f64| {
            (!(least..=most).contains(&value)).then(|| format!("{key}: is {value}, allowed is {least} to {most}"))
        };
        let mut more: Vec<String> = [
            number("world_speed", self.world_speed, 0.1, 200.0),
            number("kill_within_s", self.kill_within_s, 0.0, 86_400.0),
            number("limits.sim_s", self.limits.sim_s, 1.0, 86_400.0),
            number("limits.wall_s", self.limits.wall_s, 1.0, 86_400.0),
            (self.limits.battery_share != STOPPING_SHARE).then(|| {
                let given = self.limits.battery_share;
                format!("limits.battery_share: is {given}, allowed is {STOPPING_SHARE}: there a robot stops dead")
            }),
        ]
        .into_iter()
        .flatten()
        .collect();
        more.extend(self.travel.validation_errors());
        more.extend(self.factor_problems());
        more.extend(self.mission_problems());
        let trials = self.trials();
        check(trials <= TRIALS_MAX, format!("{trials} trials are more than the {TRIALS_MAX} allowed"));
        problems.extend(more);
        problems
    }

    /// How many trials it has.
    pub fn trials(&self) -> usize {
        let factors = &self.factors;
        let levels = [factors.speed.levels, factors.charge.levels, factors.discharge.levels, factors.location.levels];
        let scenarios = levels.into_iter().chain([factors.skills.lacking.len()]);
        let runs = [self.policies.len(), self.treatments.len(), self.repetitions as usize];
        scenarios.chain(runs).fold(1, usize::saturating_mul)
    }

    fn factor_problems(&self) -> Vec<String> {
        let (mut problems, factors) = (vec![], &self.factors);
        let robots = self.robots.iter().map(|part| part.count).fold(0, usize::saturating_add);
        if robots == 0 || robots > ROBOTS_MAX || self.robots.iter().any(|part| part.count == 0) {
            problems
                .push(format!("robots: are {robots}, allowed are 1 to {ROBOTS_MAX}, and each part has one or more"));
        }
        let mut levels = |key: &str, levels: usize| {
            if levels == 0 || levels > LEVELS_MAX {
                problems.push(format!("factors.{key}: has {levels} levels, allowed are 1 to {LEVELS_MAX}"));
            }
        };
        levels("speed", factors.speed.levels);
        levels("charge", factors.charge.levels);
        levels("discharge", factors.discharge.levels);
        levels("location", factors.location.levels);
        levels("skills", factors.skills.lacking.len());
        let mut span = |key: &str, span: &UniformRange, least: f64, most: f64| {
            let (from, to) = span.between;
            if !(least <= from && from <= to && to <= most) {
                problems.push(format!(
                    "factors.{key}.between: is [{from}, {to}], allowed are two numbers from {least} to {most}, the least first"
                ));
            }
        };
        span("speed", &factors.speed, 0.001, 100.0);
        span("charge", &factors.charge, 0.0, 1.0);
        span("discharge", &factors.discharge, 0.0, 1.0);
        let starts: BTreeSet<_> = factors.location.starts.iter().collect();
        if starts.len() < robots || starts.len() < factors.location.starts.len() {
            problems.push(format!(
                "factors.location.starts: {} places of which {} differ, allowed are {robots} or more that all differ",
                factors.location.starts.len(),
                starts.len()
            ));
        }
        let sites = &factors.location.sites;
        for (site, places) in sites {
            // Whatever the others have taken, one is left.
            let places: BTreeSet<_> = places.iter().collect();
            let rivals = sites.values().filter(|others| others.iter().any(|place| places.contains(place))).count();
            if places.len() < rivals.max(1) {
                problems.push(format!(
                    "factors.location.sites.{site}: {} places differ, allowed are as many as there are sites that share any of \
                     them, {}, or more",
                    places.len(),
                    rivals.max(1)
                ));
            }
        }
        let most = robots.saturating_sub(self.robots.len());
        for lacking in factors.skills.lacking.iter().filter(|lacking| **lacking > most) {
            problems.push(format!(
                "factors.skills.lacking: has {lacking}, allowed are 0 to {most}: of each part of `robots` one lacks nothing"
            ));
        }
        problems
    }

    fn mission_problems(&self) -> Vec<String> {
        let mut problems = vec![];
        let sites = &self.factors.location.sites;
        let mut site = |key: String, written: &str| {
            if let Some(site) = written.strip_prefix('@').filter(|site| !sites.contains_key(*site)) {
                let known = sites.keys().map(|site| format!("@{site}")).collect::<Vec<_>>().join(", ");
                let hint = did_you_mean(site, sites.keys().map(String::as_str));
                problems.push(format!("{key}: there is no site @{site}{hint}; there are: {known}"));
            }
        };
        for (name, value) in &self.mission.parameters {
            site(format!("mission.parameters.{name}"), value);
        }
        for fixed in &self.fixed {
            site(format!("fixed {}: place", fixed.name), &fixed.place);
        }
        for person in &self.people {
            site(format!("people {}: place", person.name), &person.place);
        }
        if let Some(delivered) = &self.mission.delivered {
            site("mission.delivered.to".to_owned(), &delivered.to);
            let items = || self.people.iter().flat_map(|person| &person.items).map(|item| item.as_str());
            if !items().any(|item| item == delivered.item) {
                let known = items().collect::<Vec<_>>().join(", ");
                problems.push(format!(
                    "mission.delivered.item: nobody has {:?}{}; there are: {known}",
                    delivered.item,
                    did_you_mean(&delivered.item, items())
                ));
            }
        }
        let Some(template) = shipped().get(&self.mission.name) else {
            let known = || shipped().keys().map(String::as_str);
            problems.push(format!(
                "mission.name: no mission {:?} is shipped{}; there are: {}",
                self.mission.name,
                did_you_mean(&self.mission.name, known()),
                known().collect::<Vec<_>>().join(", ")
            ));
            return problems;
        };
        // Any place does for a site here.
        let parameters: BTreeMap<String, String> = self
            .mission
            .parameters
            .iter()
            .map(|(name, value)| (name.clone(), value.trim_start_matches('@').to_owned()))
            .collect();
        match template.instantiate(&parameters, &Domain::hospital()) {
            Ok(mission) => problems.extend(self.role_problems(&mission)),
            Err(errors) => problems.extend(errors.diagnostics.iter().map(|problem| format!("mission: {problem}"))),
        }
        problems
    }

    fn role_problems(&self, mission: &Mission) -> Vec<String> {
        let roles = |kind: RoleKind| {
            let of_kind = mission.roles.iter().filter(move |(_, spec)| spec.kind == kind);
            of_kind.map(|(role, _)| role.clone()).collect::<BTreeSet<_>>()
        };
        let (managed, unmanaged) = (roles(RoleKind::Managed), roles(RoleKind::Unmanaged));
        let list = |roles: &BTreeSet<RoleId>| roles.iter().map(RoleId::as_str).collect::<Vec<_>>().join(", ");
        let mut problems = vec![];
        let robots = self.robots.iter().flat_map(|part| &part.roles).map(|role| ("robots".to_owned(), role));
        let fixed = self.fixed.iter().map(|fixed| (format!("fixed {}", fixed.name), &fixed.role));
        for (who, role) in robots.chain(fixed).filter(|(_, role)| !managed.contains(*role)) {
            problems.push(format!("{who}: {role} is no managed role; there are: {}", list(&managed)));
        }
        for person in self.people.iter().filter(|person| !unmanaged.contains(&person.role)) {
            let (name, role) = (&person.name, &person.role);
            problems.push(format!("people {name}: {role} is no unmanaged role; there are: {}", list(&unmanaged)));
        }
        problems
    }

    /// The places of a scenario that are not on a map.
    pub fn unknown_places(&self, scenario: &Scenario, map: &Map) -> Vec<String> {
        let mut problems = vec![];
        let mut look = |who: String, place: Result<PlaceId, String>| match place {
            Ok(place) if map.place(&place).is_some() => {}
            Ok(place) => {
                let (name, hint) = (map.name(), map.suggest(&place));
                problems.push(format!("{who}: there is no place {:?} on map {name}{hint}", place.as_str()));
            }
            Err(problem) => problems.push(format!("{who}: {problem}")),
        };
        for robot in &scenario.robots {
            look(format!("scenario {}, {}", scenario.code, robot.name), Ok(robot.place.clone()));
        }
        for (site, place) in &scenario.sites {
            look(format!("scenario {}, site {site}", scenario.code), Ok(place.clone()));
        }
        for fixed in &self.fixed {
            look(format!("fixed {}", fixed.name), scenario.place(&fixed.place));
        }
        for person in &self.people {
            look(format!("people {}", person.name), scenario.place(&person.place));
        }
        problems
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DeliveryGoal, Design, shipped};

    fn said(change: impl FnOnce(&mut Design)) -> Vec<String> {
        let mut design = shipped("published").unwrap().unwrap();
        change(&mut design);
        design.validation_errors()
    }

    #[test]
    fn every_mistake_is_told_with_its_key_and_what_is_allowed() {
        let mistakes = said(|design| {
            design.repetitions = 0;
            design.policies.push(design.policies[0]);
            design.world_speed = 0.0;
            design.limits.battery_share = 0.1;
            design.factors.charge.between = (0.9, 0.1);
            design.factors.skills.lacking = vec![6];
            design.factors.location.starts.truncate(3);
            design.people[0].place = "@rom".to_owned();
            design.mission.delivered = Some(DeliveryGoal { item: "sampel".to_owned(), to: "lab-arm".to_owned() });
            design.fixed[0].role = "nurse".parse().unwrap();
        });
        assert_eq!(
            mistakes,
            [
                "repetitions: is 0, allowed is 1 or more",
                "policies: one is named twice",
                "world_speed: is 0, allowed is 0.1 to 200",
                "limits.battery_share: is 0.1, allowed is 0.05: there a robot stops dead",
                "factors.charge.between: is [0.9, 0.1], allowed are two numbers from 0 to 1, the least first",
                "factors.location.starts: 3 places of which 3 differ, allowed are 6 or more that all differ",
                "factors.skills.lacking: has 6, allowed are 0 to 5: of each part of `robots` one lacks nothing",
                "people nurse: place: there is no site @rom; did you mean \"room\"?; there are: @room",
                "mission.delivered.item: nobody has \"sampel\"; did you mean \"sample\"?; there are: sample",
                "fixed lab-arm: nurse is no managed role; there are: lab_arm, r1",
            ]
        );
    }

    #[test]
    fn a_mission_that_is_not_shipped_is_told_with_those_that_are() {
        let said = said(|design| design.mission.name = "lab-sample".to_owned());
        assert_eq!(said.len(), 1);
        assert!(
            said[0].starts_with("mission.name: no mission \"lab-sample\" is shipped; did you mean \"lab-samples\"?"),
            "{said:?}"
        );
    }
}
