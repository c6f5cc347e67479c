//! Generation of scenarios: all combinations of the levels of the factors.

use super::super::seeds::generator;
use super::{Design, FactorLevels, LocationFactor, Scenario, ScenarioRobot, SkillGaps, UniformRange};
use consort_protocol::ids::{PlaceId, RobotId, TaskType};
use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};

/// Returns `a`, `b`, … for a level.
pub(super) fn level_name(level: usize) -> String {
    char::from(b'a' + u8::try_from(level.min(25)).unwrap_or(25)).to_string()
}

/// Returns the scenarios of a valid design, in the order of their codes. The draws of a level
/// depend only on the name and the seed of the design, its factor and its own name: an additional
/// level leaves the others unchanged.
pub fn scenarios(design: &Design) -> Vec<Scenario> {
    let rng = |factor: &str, level: usize| generator(design.seed, &[&design.name, factor, &level_name(level)]);
    let robots: usize = design.robots.iter().map(|part| part.count).sum();
    let spans = |factor: &str, span: &UniformRange| -> Vec<Vec<f64>> {
        (0..span.levels).map(|level| draw_numbers(span, robots, &mut rng(factor, level))).collect()
    };
    let factors = &design.factors;
    let (speeds, charges) = (spans("speed", &factors.speed), spans("charge", &factors.charge));
    let discharges = spans("discharge", &factors.discharge);
    let sites = site_orders(&factors.location, &mut generator(design.seed, &[&design.name, "sites"]));
    let locations: Vec<_> = (0..factors.location.levels)
        .map(|level| draw_places(&factors.location, &sites, level, robots, &mut rng("location", level)))
        .collect();
    let skills: Vec<_> = (0..factors.skills.lacking.len())
        .map(|level| draw_skills(design, &factors.skills, level, &mut rng("skills", level)))
        .collect();

    let mut scenarios = vec![];
    for (a, speed) in speeds.iter().enumerate() {
        for (b, charge) in charges.iter().enumerate() {
            for (c, discharge) in discharges.iter().enumerate() {
                for (d, (places, sites)) in locations.iter().enumerate() {
                    for (e, skills) in skills.iter().enumerate() {
                        let levels = [a, b, c, d, e].map(level_name);
                        let parts = design.robots.iter().flat_map(|part| std::iter::repeat_n(part, part.count));
                        let robot = |(index, part): (usize, &super::RobotGroup)| ScenarioRobot {
                            name: RobotId::new(format!("r{}", index + 1)).expect("r and a number form a slug"),
                            speed_mps: speed[index],
                            charge: charge[index],
                            discharge: discharge[index],
                            place: places[index].clone(),
                            skills: skills[index].clone(),
                            drawer: part.drawer,
                            arm: part.arm,
                            roles: part.roles.clone(),
                        };
                        let code = levels.concat();
                        let [speed_level, charge_level, discharge_level, location, skills_level] = levels;
                        scenarios.push(Scenario {
                            code,
                            levels: FactorLevels {
                                speed: speed_level,
                                charge: charge_level,
                                discharge: discharge_level,
                                location,
                                skills: skills_level,
                            },
                            sites: sites.clone(),
                            robots: parts.enumerate().map(robot).collect(),
                        });
                    }
                }
            }
        }
    }
    scenarios
}

fn draw_numbers(span: &UniformRange, robots: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let (least, most) = span.between;
    (0..robots).map(|_| rng.random_range(least..=most)).collect()
}

/// Returns the candidates of each site in random order; the levels take them in turn.
fn site_orders(location: &LocationFactor, rng: &mut ChaCha8Rng) -> BTreeMap<String, Vec<PlaceId>> {
    let shuffled = |(name, places): (&String, &Vec<PlaceId>)| {
        let mut places = places.clone();
        places.shuffle(rng);
        (name.clone(), places)
    };
    location.sites.iter().map(shuffled).collect()
}

fn draw_places(
    location: &LocationFactor,
    orders: &BTreeMap<String, Vec<PlaceId>>,
    level: usize,
    robots: usize,
    rng: &mut ChaCha8Rng,
) -> (Vec<PlaceId>, BTreeMap<String, PlaceId>) {
    let mut starts = location.starts.clone();
    starts.shuffle(rng);
    starts.truncate(robots);
    let mut sites: BTreeMap<String, PlaceId> = BTreeMap::new();
    for (name, places) in orders {
        let turns = (0..places.len()).map(|turn| &places[(level + turn) % places.len()]);
        let mut free = turns.filter(|place| !sites.values().any(|taken| taken == *place));
        // A valid design has a free place for each site.
        if let Some(place) = free.next() {
            sites.insert(name.clone(), place.clone());
        }
    }
    (starts, sites)
}

fn draw_skills(design: &Design, skills: &SkillGaps, level: usize, rng: &mut ChaCha8Rng) -> Vec<BTreeSet<TaskType>> {
    let mut all: Vec<BTreeSet<TaskType>> =
        design.robots.iter().flat_map(|part| std::iter::repeat_n(part.skills.clone(), part.count)).collect();
    // In each group a random robot keeps all its skills.
    let mut may_lose_skill = vec![];
    let mut first = 0;
    for part in &design.robots {
        let mut members: Vec<usize> = (first..first + part.count).collect();
        members.shuffle(rng);
        may_lose_skill.extend(members.into_iter().skip(1));
        first += part.count;
    }
    may_lose_skill.shuffle(rng);
    for robot in may_lose_skill.into_iter().take(skills.lacking[level]) {
        let own: Vec<TaskType> = all[robot].iter().cloned().collect();
        if let Some(lost) = own.choose(rng) {
            all[robot].remove(lost);
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::super::shipped;
    use super::*;

    fn published() -> Design {
        shipped("published").unwrap().unwrap()
    }

    #[test]
    fn the_published_design_has_81_scenarios_of_six_robots() {
        let scenarios = scenarios(&published());
        assert_eq!(scenarios.len(), 81);
        let codes: BTreeSet<&str> = scenarios.iter().map(|scenario| scenario.code.as_str()).collect();
        assert_eq!((codes.len(), scenarios[0].code.as_str(), scenarios[80].code.as_str()), (81, "aaaaa", "acccc"));
        for scenario in &scenarios {
            assert_eq!(scenario.robots.len(), 6);
            let places: BTreeSet<_> = scenario.robots.iter().map(|robot| &robot.place).collect();
            assert_eq!(places.len(), 6, "each robot starts at a different place");
            let full = &published().robots[0].skills;
            let lacking = scenario.robots.iter().filter(|robot| robot.skills.len() == full.len() - 1).count();
            let expected = match scenario.levels.skills.as_str() {
                "a" => 4,
                "b" => 2,
                _ => 0,
            };
            assert_eq!(lacking, expected, "{}", scenario.code);
            assert!(scenario.robots.iter().all(|robot| (0.05..=0.95).contains(&robot.charge)));
        }
        let rooms: BTreeSet<_> = scenarios.iter().map(|scenario| &scenario.sites["room"]).collect();
        assert_eq!(rooms.len(), 3, "each level of the location has the nurse in a different room");
    }

    #[test]
    fn an_additional_level_leaves_the_others_unchanged() {
        let before = published();
        let mut more = before.clone();
        more.factors.charge.levels = 4;
        let after = scenarios(&more);
        assert_eq!(after.len(), 108);
        for scenario in scenarios(&before) {
            assert!(after.contains(&scenario), "{}", scenario.code);
        }
        let other = scenarios(&Design { seed: 7, ..before });
        assert!(other.iter().all(|scenario| !after.contains(scenario)));
    }
}
