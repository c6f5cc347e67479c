//! Validation of a design; each error contains its key.

use super::{Design, PlaceError, Scenario, UniformRange};
use consort_protocol::ids::{PlaceId, RoleId, TaskId};
use consort_protocol::mission::{Mission, RoleKind};
use consort_skills::workload::Workload;
use consort_world::map::Map;
use consort_world::suggest::did_you_mean;
use consort_world::world::STOPPING_SHARE;
use std::collections::{BTreeMap, BTreeSet};

/// Most levels of a factor: letters name the levels.
const LEVELS_MAX: usize = 26;

/// Most mobile robots.
const ROBOTS_MAX: usize = 99;

/// Most trials of a design.
const TRIALS_MAX: usize = 1_000_000;

impl Design {
    /// Returns all errors in the content of the design, whose mission is shipped or in the workload.
    /// [`unknown_places`](Design::unknown_places) checks the places.
    pub fn validation_errors(&self, workload: &Workload) -> Vec<String> {
        let mut violations = vec![];
        let mut check = |sound: bool, error: String| {
            if !sound {
                violations.push(error);
            }
        };
        let slug = RoleId::new(self.name.as_str()).map(|_| ()).map_err(|error| error.to_string());
        check(slug.is_ok(), format!("name: {}", slug.err().unwrap_or_default()));
        check(self.repetitions > 0, "repetitions: is 0, allowed: 1 or more".to_owned());
        check(!self.policies.is_empty(), "policies: is empty, allowed: 1 or more".to_owned());
        check(!self.treatments.is_empty(), "treatments: is empty, allowed: 1 or more".to_owned());
        let distinct: BTreeSet<_> = self.policies.iter().collect();
        check(distinct.len() == self.policies.len(), "policies: a policy is listed twice".to_owned());
        let distinct: BTreeSet<_> = self.treatments.iter().collect();
        check(distinct.len() == self.treatments.len(), "treatments: a treatment is listed twice".to_owned());
        let number = |key: &str, value: f64, least: f64, most: f64| {
            (!(least..=most).contains(&value)).then(|| format!("{key}: is {value}, allowed: {least} to {most}"))
        };
        let mut further: Vec<String> = [
            number("world_speed", self.world_speed, 0.1, 200.0),
            number("kill_within_s", self.kill_within_s, 0.0, 86_400.0),
            number("limits.sim_s", self.limits.sim_s, 1.0, 86_400.0),
            number("limits.wall_s", self.limits.wall_s, 1.0, 86_400.0),
            (self.limits.battery_share != STOPPING_SHARE).then(|| {
                let given = self.limits.battery_share;
                format!("limits.battery_share: is {given}, allowed: {STOPPING_SHARE}: a robot stops at this charge")
            }),
        ]
        .into_iter()
        .flatten()
        .collect();
        further.extend(self.travel.validation_errors());
        further.extend(self.factor_problems());
        further.extend(self.mission_problems(workload));
        let trials = self.trials();
        check(trials <= TRIALS_MAX, format!("{trials} trials are more than the {TRIALS_MAX} allowed"));
        violations.extend(further);
        violations
    }

    /// Returns the number of trials.
    pub fn trials(&self) -> usize {
        let factors = &self.factors;
        let levels = [factors.speed.levels, factors.charge.levels, factors.discharge.levels, factors.location.levels];
        let scenarios = levels.into_iter().chain([factors.skills.lacking.len()]);
        let runs = [self.policies.len(), self.treatments.len(), self.repetitions as usize];
        scenarios.chain(runs).fold(1, usize::saturating_mul)
    }

    fn factor_problems(&self) -> Vec<String> {
        let (mut violations, factors) = (vec![], &self.factors);
        let robots = self.robots.iter().map(|part| part.count).fold(0, usize::saturating_add);
        if robots == 0 || robots > ROBOTS_MAX || self.robots.iter().any(|part| part.count == 0) {
            violations.push(format!("robots: {robots} in total, allowed: 1 to {ROBOTS_MAX}, at least 1 in each group"));
        }
        let mut levels = |key: &str, levels: usize| {
            if levels == 0 || levels > LEVELS_MAX {
                violations.push(format!("factors.{key}: has {levels} levels, allowed are 1 to {LEVELS_MAX}"));
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
                violations.push(format!(
                    "factors.{key}.between: is [{from}, {to}], allowed are two numbers from {least} to {most}, the least first"
                ));
            }
        };
        span("speed", &factors.speed, 0.001, 100.0);
        span("charge", &factors.charge, 0.0, 1.0);
        span("discharge", &factors.discharge, 0.0, 1.0);
        let starts: BTreeSet<_> = factors.location.starts.iter().collect();
        if starts.len() < robots || starts.len() < factors.location.starts.len() {
            violations.push(format!(
                "factors.location.starts: {} places, {} of them different; allowed: {robots} or more different places",
                factors.location.starts.len(),
                starts.len()
            ));
        }
        let sites = &factors.location.sites;
        for (site, places) in sites {
            // Each site needs a free candidate when all other sites have taken one of its
            // candidates.
            let places: BTreeSet<_> = places.iter().collect();
            let rivals = sites.values().filter(|others| others.iter().any(|place| places.contains(place))).count();
            if places.len() < rivals.max(1) {
                violations.push(format!(
                    "factors.location.sites.{site}: {} different places, allowed: at least as many as there are sites with common \
                     candidates: {}",
                    places.len(),
                    rivals.max(1)
                ));
            }
        }
        let most = robots.saturating_sub(self.robots.len());
        for lacking in factors.skills.lacking.iter().filter(|lacking| **lacking > most) {
            violations.push(format!(
                "factors.skills.lacking: has {lacking}, allowed: 0 to {most}: a robot of each group of `robots` keeps all its skills"
            ));
        }
        violations
    }

    fn mission_problems(&self, workload: &Workload) -> Vec<String> {
        let mut violations = vec![];
        let sites = &self.factors.location.sites;
        let mut site = |key: String, written: &str| {
            if let Some(site) = written.strip_prefix('@').filter(|site| !sites.contains_key(*site)) {
                let known = sites.keys().map(|site| format!("@{site}")).collect::<Vec<_>>().join(", ");
                let hint = did_you_mean(site, sites.keys().map(String::as_str));
                violations.push(format!("{key}: there is no site @{site}{hint}; sites: {known}"));
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
                violations.push(format!(
                    "mission.delivered.item: no person has {:?}{}; items: {known}",
                    delivered.item,
                    did_you_mean(&delivered.item, items())
                ));
            }
        }
        let Some(mission) = workload.mission(&self.mission.name) else {
            let known = || workload.mission_names();
            violations.push(format!(
                "mission.name: there is no mission {:?}{}; missions: {}",
                self.mission.name,
                did_you_mean(&self.mission.name, known()),
                known().collect::<Vec<_>>().join(", ")
            ));
            return violations;
        };
        // The place of a site does not matter for this check.
        let parameters: BTreeMap<String, String> = self
            .mission
            .parameters
            .iter()
            .map(|(name, value)| (name.clone(), value.trim_start_matches('@').to_owned()))
            .collect();
        match mission.instantiate(&parameters, &workload.extensions.domain()) {
            Ok(mission) => {
                violations.extend(self.role_problems(&mission));
                violations.extend(self.phase_problems(&mission));
            }
            Err(errors) => violations.extend(errors.diagnostics.iter().map(|error| format!("mission: {error}"))),
        }
        violations
    }

    fn role_problems(&self, mission: &Mission) -> Vec<String> {
        let roles = |kind: RoleKind| {
            let of_kind = mission.roles.iter().filter(move |(_, spec)| spec.kind == kind);
            of_kind.map(|(role, _)| role.clone()).collect::<BTreeSet<_>>()
        };
        let (managed, unmanaged) = (roles(RoleKind::Managed), roles(RoleKind::Unmanaged));
        let list = |roles: &BTreeSet<RoleId>| roles.iter().map(RoleId::as_str).collect::<Vec<_>>().join(", ");
        let mut violations = vec![];
        let robots = self.robots.iter().flat_map(|part| &part.roles).map(|role| ("robots".to_owned(), role));
        let fixed = self.fixed.iter().map(|fixed| (format!("fixed {}", fixed.name), &fixed.role));
        for (owner, role) in robots.chain(fixed).filter(|(_, role)| !managed.contains(*role)) {
            violations.push(format!("{owner}: {role} is not a managed role; managed roles: {}", list(&managed)));
        }
        for person in self.people.iter().filter(|person| !unmanaged.contains(&person.role)) {
            let (name, role) = (&person.name, &person.role);
            violations
                .push(format!("people {name}: {role} is not an unmanaged role; unmanaged roles: {}", list(&unmanaged)));
        }
        violations
    }

    fn phase_problems(&self, mission: &Mission) -> Vec<String> {
        let phases = &self.mission.phases;
        let managed: BTreeSet<&RoleId> = mission.managed_roles().collect();
        let elementary = mission.elementary();
        let names = || elementary.iter().map(|(task, _)| task.as_str());
        let times = |task: &TaskId| phases.iter().filter(|phase| phase.tasks.contains(task)).count();
        let mut violations = vec![];
        for phase in phases {
            for task in phase.tasks.iter().filter(|task| names().all(|name| name != task.as_str())) {
                let hint = did_you_mean(task.as_str(), names());
                violations.push(format!("mission.phases.{}: the mission has no task {task}{hint}", phase.name));
            }
        }
        for (task, spec) in elementary.iter().filter(|_| !phases.is_empty()) {
            let (times, needed) = (times(task), spec.roles.iter().any(|role| managed.contains(role)));
            if times > 1 || (times == 0 && needed) {
                violations.push(format!("mission.phases: {task} is in {times} phases, allowed: a single phase"));
            }
        }
        violations
    }

    /// Returns an error for each place of a scenario that is not on the map.
    pub fn unknown_places(&self, scenario: &Scenario, map: &Map) -> Vec<String> {
        let mut violations = vec![];
        let mut check_place = |owner: String, place: Result<PlaceId, PlaceError>| match place {
            Ok(place) if map.place(&place).is_some() => {}
            Ok(place) => {
                let (name, hint) = (map.name(), map.suggest(&place));
                violations.push(format!("{owner}: there is no place {:?} on map {name}{hint}", place.as_str()));
            }
            Err(error) => violations.push(format!("{owner}: {error}")),
        };
        for robot in &scenario.robots {
            check_place(format!("scenario {}, {}", scenario.code, robot.name), Ok(robot.place.clone()));
        }
        for (site, place) in &scenario.sites {
            check_place(format!("scenario {}, site {site}", scenario.code), Ok(place.clone()));
        }
        for fixed in &self.fixed {
            check_place(format!("fixed {}", fixed.name), scenario.place(&fixed.place));
        }
        for person in &self.people {
            check_place(format!("people {}", person.name), scenario.place(&person.place));
        }
        violations
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DeliveryGoal, Design, shipped};
    use consort_skills::workload::Workload;

    fn errors_after(change: impl FnOnce(&mut Design)) -> Vec<String> {
        let mut design = shipped("published").unwrap().unwrap();
        change(&mut design);
        design.validation_errors(&Workload::default())
    }

    #[test]
    fn every_error_is_reported_with_its_key_and_allowed_values() {
        let mistakes = errors_after(|design| {
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
                "repetitions: is 0, allowed: 1 or more",
                "policies: a policy is listed twice",
                "world_speed: is 0, allowed: 0.1 to 200",
                "limits.battery_share: is 0.1, allowed: 0.05: a robot stops at this charge",
                "factors.charge.between: is [0.9, 0.1], allowed are two numbers from 0 to 1, the least first",
                "factors.location.starts: 3 places, 3 of them different; allowed: 6 or more different places",
                "factors.skills.lacking: has 6, allowed: 0 to 5: a robot of each group of `robots` keeps all its skills",
                "people nurse: place: there is no site @rom; did you mean \"room\"?; sites: @room",
                "mission.delivered.item: no person has \"sampel\"; did you mean \"sample\"?; items: sample",
                "fixed lab-arm: nurse is not a managed role; managed roles: lab_arm, r1",
            ]
        );
    }

    #[test]
    fn every_managed_task_is_in_a_single_phase() {
        let mistakes = errors_after(|design| {
            design.mission.phases[0].tasks = ["navto_rom".parse().unwrap()].into();
            design.mission.phases[1].tasks.insert("navto_lab".parse().unwrap());
            // The task of the nurse may be left out.
            design.mission.phases[1].tasks.remove(&"deposit".parse().unwrap());
        });
        assert_eq!(
            mistakes,
            [
                "mission.phases.navto_room: the mission has no task navto_rom; did you mean \"navto_room\"?",
                "mission.phases: navto_room is in 0 phases, allowed: a single phase",
                "mission.phases: navto_lab is in 2 phases, allowed: a single phase",
            ]
        );
    }

    #[test]
    fn an_unknown_mission_is_reported_with_the_shipped_ones() {
        let errors_after = errors_after(|design| design.mission.name = "lab-sample".to_owned());
        assert_eq!(errors_after.len(), 1);
        assert!(
            errors_after[0]
                .starts_with("mission.name: there is no mission \"lab-sample\"; did you mean \"lab-samples\"?"),
            "{errors_after:?}"
        );
    }
}
