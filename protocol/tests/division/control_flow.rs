//! Random mission files with conditions, choices, loops and repetitions: their local plans end in every
//! order of events, whatever the tasks return, and all roles skip the same tasks.

use crate::control_flow_crew::{Branches, Crew, Ending};
use crate::properties::SeededRng;
use consort_protocol::ledger::MissionState;
use consort_protocol::mission::{Domain, Format, Mission, MissionTemplate, NumberRange, TaskSchema, ValueKind};
use consort_protocol::plan::divide_and_check;
use proptest::prelude::*;
use proptest::sample::subsequence;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// Part of a mission file, without its conditions.
#[derive(Debug, Clone)]
enum Part {
    /// Task of these roles, by number.
    Work(Vec<usize>),
    Group {
        is_sequence: bool,
        parts: Vec<Part>,
    },
    When(Box<Part>),
    Choose {
        branches: Vec<Part>,
        otherwise: Option<Box<Part>>,
    },
    Loop {
        count: usize,
        kind: LoopKind,
        body: Box<Part>,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LoopKind {
    Sequential,
    Unordered,
    Spread,
    Repeat,
}

use LoopKind::{Repeat, Sequential, Spread, Unordered};

/// Generates parts of mission files of these roles, with loops of these kinds.
fn parts(roles: usize, size: u32, kinds: &'static [LoopKind]) -> impl Strategy<Value = Part> {
    let one = (0..roles).prop_map(|role| Part::Work(vec![role]));
    let joint = subsequence((0..roles).collect::<Vec<_>>(), 2..=2.min(roles)).prop_shuffle().prop_map(Part::Work);
    prop_oneof![3 => one, 1 => joint].prop_recursive(4, size, 3, move |below| {
        let some = || prop::collection::vec(below.clone(), 1..=3);
        let boxed = || below.clone().prop_map(Box::new);
        let kind = prop::sample::select(kinds);
        prop_oneof![
            4 => (prop::bool::weighted(0.7), some()).prop_map(|(is_sequence, parts)| Part::Group { is_sequence, parts }),
            2 => boxed().prop_map(Part::When),
            2 => (some(), prop::option::of(boxed()))
                .prop_map(|(branches, otherwise)| Part::Choose { branches, otherwise }),
            3 => (1..=3_usize, kind, boxed()).prop_map(|(count, kind, body)| Part::Loop { count, kind, body }),
        ]
    })
}

/// A mission file under construction.
struct FileWriter {
    rng: SeededRng,
    /// Number of names given so far.
    names: usize,
    roles: BTreeSet<String>,
    /// Tasks that have ended before the next task, by the names that expressions use here.
    known: Vec<String>,
    /// Loops around the current part.
    loops: usize,
    /// Role of the innermost spread loop around the current part.
    own_role: Option<String>,
    /// In spread loops, no task has another role than that of the loop.
    is_spread_alone: bool,
}

impl FileWriter {
    fn new(seed: u64, is_spread_alone: bool) -> FileWriter {
        FileWriter {
            rng: SeededRng(seed),
            names: 0,
            roles: BTreeSet::new(),
            known: vec![],
            loops: 0,
            own_role: None,
            is_spread_alone,
        }
    }

    fn name(&mut self, kind: char) -> String {
        self.names += 1;
        format!("{kind}{}", self.names)
    }

    fn choose_known(&mut self) -> Option<String> {
        let number = self.rng.below(self.known.len().max(1));
        self.known.get(number).cloned()
    }

    fn condition(&mut self) -> String {
        let (Some(one), Some(other)) = (self.choose_known(), self.choose_known()) else {
            return ["true", "false"][self.rng.below(2)].to_owned();
        };
        match self.rng.below(5) {
            0 => format!("{one}.ok"),
            1 => format!("!{one}.ok"),
            2 => format!("{one}.level > 1.5"),
            3 => format!("{one}.ok && !{other}.ok"),
            _ => format!("{one}.level > 2.5 || {other}.ok"),
        }
    }

    /// Forgets the tasks after the first `count`, which may be skipped. A few stay: their results may be unknown.
    fn forget(&mut self, count: usize) {
        if self.rng.below(8) > 0 {
            self.known.truncate(count);
        }
    }

    fn part(&mut self, part: &Part) -> Value {
        match part {
            Part::Work(roles) => self.work(roles),
            Part::Group { is_sequence, parts } => {
                let before = self.known.clone();
                let mut after = before.clone();
                let mut tasks = vec![];
                for part in parts {
                    if !is_sequence {
                        self.known.clone_from(&before);
                    }
                    let count = self.known.len();
                    tasks.push(self.part(part));
                    after.extend(self.known.drain(count..).collect::<Vec<_>>());
                    if *is_sequence {
                        self.known.clone_from(&after);
                    }
                }
                self.known = after;
                let method = if *is_sequence { "sequential" } else { "unordered" };
                json!({ "task": self.name('a'), "method": method, "tasks": tasks })
            }
            Part::When(body) => {
                let (condition, count) = (self.condition(), self.known.len());
                let body = self.part(body);
                self.forget(count);
                json!({ "task": self.name('a'), "method": "sequential", "when": condition, "tasks": [body] })
            }
            Part::Choose { branches, otherwise } => {
                let before = self.known.clone();
                let mut seen = before.clone();
                let mut branch = |writer: &mut Self, part: &Part| {
                    writer.known.clone_from(&before);
                    let body = writer.part(part);
                    seen.extend(writer.known.split_off(before.len()));
                    writer.known.clone_from(&before);
                    body
                };
                let mut choices = vec![];
                for part in branches {
                    let condition = self.condition();
                    choices.push(json!({ "when": condition, "do": branch(self, part) }));
                }
                let mut task = json!({ "task": "", "choose": choices });
                if let Some(part) = otherwise {
                    task["else"] = branch(self, part);
                }
                let count = before.len();
                self.known = seen;
                self.forget(count);
                task["task"] = json!(self.name('a'));
                task
            }
            Part::Loop { count, kind, body } => self.repeated(*count, *kind, body),
        }
    }

    fn work(&mut self, roles: &[usize]) -> Value {
        let own = self.own_role.clone();
        let others = roles.iter().map(|role| format!("r{role}"));
        let roles: Vec<String> = match own {
            Some(own) if self.is_spread_alone => vec![own],
            Some(own) => [own].into_iter().chain(others.skip(1)).collect(),
            None => others.collect(),
        };
        self.roles.extend(roles.iter().cloned());
        let mut task = json!({ "task": self.name('t'), "type": "work", "roles": roles });
        if self.rng.below(4) == 0
            && let Some(known) = self.choose_known()
        {
            task["parameters"] = json!({ "effort": format!("${{{known}.level}}") });
        }
        self.known.extend(task["task"].as_str().map(str::to_owned));
        task
    }

    fn repeated(&mut self, count: usize, kind: LoopKind, body: &Part) -> Value {
        let before = self.known.len();
        let outer_role = self.own_role.clone();
        if kind == Spread && !(self.is_spread_alone && outer_role.is_some()) {
            self.own_role = Some(self.name('s'));
        }
        let is_spread = self.own_role != outer_role;
        self.loops += 1;
        let body = self.part(body);
        self.loops -= 1;
        self.own_role = outer_role;
        let mut task = match kind {
            Repeat => json!({ "repeat": count, "do": body, "until": self.condition() }),
            Sequential | Unordered | Spread => {
                let values = (0..count).map(|value| value.to_string()).collect::<Vec<_>>();
                json!({ "for": self.name('v'), "in": values, "do": body })
            }
        };
        match kind {
            Spread if is_spread => task["spread"] = json!(true),
            Unordered => task["method"] = json!("unordered"),
            Sequential | Spread | Repeat => {}
        }
        // After the loop, expressions use the full names of its tasks, which are known outside all loops only.
        let inside = self.known.split_off(before);
        let certain = if kind == Repeat { 1 } else { count };
        let plain = inside.iter().filter(|name| self.loops == 0 && !name.contains('_'));
        self.known.extend(plain.flat_map(|name| (1..=certain).map(move |number| format!("{name}_{number}"))));
        task["task"] = json!(self.name('a'));
        task
    }

    /// Returns the file with this root. Role `r0` is a person if robots take part, too.
    fn file(&self, root: Value) -> Value {
        let is_person = |role: &str| role == "r0" && self.roles.len() > 1 && !self.is_spread_alone;
        let kind = |role: &String| if is_person(role) { "unmanaged" } else { "managed" };
        let on_loss = |role: &String| if is_person(role) { "fail" } else { "restart" };
        let declared = |role: &String| (role.clone(), json!({ "kind": kind(role), "on_loss": on_loss(role) }));
        let roles: BTreeMap<String, Value> = self.roles.iter().map(declared).collect();
        json!({ "mission": "random", "roles": roles, "root": root })
    }
}

fn domain() -> Domain {
    let number = || ValueKind::Number(NumberRange::default());
    let work = TaskSchema::default().optional("effort", number());
    let work = work.returning("ok", ValueKind::Bool).returning("level", number());
    Domain::default().with("work".parse().unwrap(), work)
}

/// Returns the file with the conditions of a seed.
fn file(part: &Part, seed: u64, is_spread_alone: bool) -> Value {
    let mut writer = FileWriter::new(seed, is_spread_alone);
    let root = writer.part(part);
    writer.file(root)
}

/// Returns a file with an item, which a robot carries during the part, and with a second part as recovery branch.
fn file_with_recovery(part: &Part, recovery: &Part, seed: u64) -> Value {
    let mut writer = FileWriter::new(seed, false);
    let main = writer.part(part);
    writer.known.clear();
    let recovery = writer.part(recovery);
    writer.roles.insert("porter".to_owned());
    let work = |task: &str| json!({ "task": task, "type": "work", "roles": ["porter"] });
    let (mut take, mut give, mut find) = (work("take"), work("give"), work("find"));
    take["acquires"] = json!({ "parcel": "porter" });
    give["releases"] = json!(["parcel"]);
    find["releases"] = json!(["parcel"]);
    let sequence = |name: &str, tasks: Value| json!({ "task": name, "method": "sequential", "tasks": tasks });
    let mut file = writer.file(sequence("all", json!([take, main, give])));
    file["recovery"] = sequence("again", json!([recovery, find]));
    file
}

/// Returns the divided mission, or the problems that the checks of files have found.
fn divided(file: &Value) -> Result<Branches, String> {
    let template = MissionTemplate::parse(&file.to_string(), Format::Json).map_err(|problem| problem.to_string())?;
    let checked = template.instantiate_with_recovery(&BTreeMap::new(), &domain());
    let (mission, recovery) = checked.map_err(|problem| problem.to_string())?;
    let divide = |mission: &Mission| divide_and_check(mission).unwrap_or_else(|problem| panic!("{problem}\n{file:#}"));
    let division = divide(&mission);
    let recovery = recovery.map(|recovery| {
        let division = divide(&recovery);
        (recovery, division)
    });
    Ok((mission, division, recovery))
}

const ALL: &[LoopKind] = &[Sequential, Unordered, Spread, Repeat];

/// Rejects are files that exceed a limit. Their number is bounded, so that the generator stays useful.
fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, max_global_rejects: cases, failure_persistence: None, ..ProptestConfig::default() }
}

fn run(file: &Value, branches: &Branches, robots: usize, losses: usize, seed: u64) -> Result<Ending, TestCaseError> {
    let crew = Crew::of(branches, robots, losses, seed);
    crew.run().map_err(|problem| TestCaseError::fail(format!("{problem}\n{file:#}")))
}

/// An unknown result is the only reason for which a mission without losses may fail.
fn is_expected(ending: &Ending) -> bool {
    match &ending.state {
        MissionState::Completed => true,
        MissionState::Failed { cause, .. } => cause.contains("skipped"),
        _ => false,
    }
}

proptest! {
    #![proptest_config(cases(60))]

    /// There is a robot for each managed role.
    #[test]
    fn missions_with_branches_and_repetition_end_in_every_run(part in parts(4, 14, ALL), seed: u64) {
        let file = file(&part, seed, false);
        let divided = divided(&file);
        prop_assume!(divided.is_ok());
        let branches = divided.unwrap();
        let robots = branches.0.managed_roles().count();
        for walk in 0..3 {
            let ending = run(&file, &branches, robots, 0, seed ^ walk)?;
            prop_assert!(is_expected(&ending), "{:?}\n{:#}", ending, file);
        }
    }

    /// There is a robot more than there are roles outside spread loops, so robots take the roles of loops in turn.
    #[test]
    fn few_robots_share_the_roles_of_spread_loops(part in parts(3, 12, &[Sequential, Spread, Spread]), seed: u64) {
        let file = file(&part, seed, true);
        let divided = divided(&file);
        prop_assume!(divided.is_ok());
        let branches = divided.unwrap();
        let robots = branches.0.roles.values().filter(|role| !role.spread).count() + 1;
        for walk in 0..3 {
            let ending = run(&file, &branches, robots, 0, seed ^ walk)?;
            prop_assert!(is_expected(&ending), "{:?}\n{:#}", ending, file);
        }
    }

    /// Robots are lost at any moment. Their successors skip the same tasks, and a lost item leads to the
    /// recovery branch.
    #[test]
    fn lost_robots_and_recovery_branches_end_in_every_run(
        part in parts(3, 10, ALL),
        recovery in parts(3, 8, ALL),
        seed: u64,
    ) {
        let file = file_with_recovery(&part, &recovery, seed);
        let divided = divided(&file);
        prop_assume!(divided.is_ok());
        let branches = divided.unwrap();
        let count = |mission: &Mission| mission.managed_roles().count();
        let robots = count(&branches.0).max(branches.2.as_ref().map_or(0, |(mission, _)| count(mission)));
        for walk in 0..3 {
            run(&file, &branches, robots, 3, seed ^ walk)?;
        }
    }
}

/// A role outside the loop takes part in every iteration, so the iterations follow the order of the file. A robot
/// for the loop is enough, whichever of the iterations to be auctioned it gets.
#[test]
fn a_single_robot_takes_iterations_that_a_role_outside_orders() {
    let task = |name: &str, roles: &[&str]| json!({ "task": name, "type": "work", "roles": roles });
    let visit = json!({ "task": "visit", "method": "sequential",
        "tasks": [task("go", &["escort"]), task("meet", &["escort", "host"]), task("leave", &["escort"])] });
    let visits = json!({ "task": "visits", "for": "number", "in": ["1", "2", "3", "4"], "spread": true, "do": visit });
    let root = json!({ "task": "all", "method": "sequential",
        "tasks": [visits, task("note", &["host"]), task("report", &["head"])] });
    // The head waits for the visits by way of the host. A host that is a robot needs one more.
    for (host, robots) in [("unmanaged", 1), ("managed", 2)] {
        let roles = json!({ "escort": { "kind": "managed" }, "host": { "kind": host }, "head": { "kind": "managed" } });
        let file = json!({ "mission": "reception", "roles": roles, "root": root });
        let branches = divided(&file).unwrap();
        for seed in 0..20 {
            let ending = run(&file, &branches, robots, 0, seed).unwrap();
            assert_eq!(ending.state, MissionState::Completed, "{host} host, seed {seed}");
        }
    }
}

/// The properties above would hold without a task that is executed, or without one that is skipped.
#[test]
fn most_random_missions_complete_and_many_skip_tasks() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    let (mut completed, mut with_skips, mut with_spread) = (0, 0, 0);
    for seed in 0..60 {
        let part = parts(4, 14, ALL).new_tree(&mut runner).unwrap().current();
        let file = file(&part, seed, false);
        let Ok(branches) = divided(&file) else { continue };
        let ending = run(&file, &branches, branches.0.managed_roles().count(), 0, seed).unwrap();
        completed += u32::from(ending.state == MissionState::Completed);
        with_skips += u32::from(ending.skipped > 0 && ending.executed > 0);
        with_spread += u32::from(branches.0.roles.values().any(|role| role.spread));
    }
    assert!(completed >= 30 && with_skips >= 5 && with_spread >= 2, "{completed} {with_skips} {with_spread}");
}
