//! What chaos puts into nodes before they start: disks that forget, clocks that drift, skills that go wrong.

use super::chaos_fleet::{ARM, ChaosFleet};
use super::schedule::{ChaosAction, Schedule, SkillFault};
use crate::AdjustNode;
use crate::disk::VirtualDisk;
use consort_actors::clock::Clock;
use consort_actors::node::NodeSettings;
use consort_protocol::units::{Seconds, WorldTime};
use consort_sim::map;
use consort_skills::bt::{Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeSpec, NodeStatus};
use consort_skills::environment::Environment;
use consort_skills::library::SkillLibrary;
use consort_skills::skill::TaskContext;
use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::time::Instant;

/// How long a skill hangs, in seconds of the world: half a minute at ten times the speed.
const HANGS_S: f64 = 300.0;

/// The date at which every run begins, in milliseconds since 1970.
const DATE_MS: u64 = 1_790_000_000_000;

/// What goes wrong next with a robot's skills.
type Mishaps = Arc<Mutex<VecDeque<SkillFault>>>;

/// The gear of one fleet. Clones are the same.
#[derive(Clone)]
pub(super) struct FaultInjector(Rc<RefCell<Parts>>);

struct Parts {
    started: Instant,
    seed: u64,
    disks: BTreeMap<String, VirtualDisk>,
    /// Disks that were ever put in.
    put_in: u64,
    rates: BTreeMap<String, f64>,
    mishaps: BTreeMap<String, Mishaps>,
    libraries: BTreeMap<String, Arc<SkillLibrary>>,
}

impl FaultInjector {
    pub(super) fn new(seed: u64, cast: &ChaosFleet, schedule: &Schedule) -> FaultInjector {
        let drift = |act: &ChaosAction| {
            if let ChaosAction::Drift { node, rate } = act { Some((node.clone(), *rate)) } else { None }
        };
        let rates = schedule.steps.iter().filter_map(|step| drift(&step.action)).collect();
        let map = map::shipped("hospital").expect("the shipped map is sound");
        let environment = map.environment().expect("the shipped map is sound");
        let robots = cast.carriers.iter().copied().chain([ARM]);
        let mishaps: BTreeMap<String, Mishaps> = robots.map(|robot| (robot.to_owned(), Mishaps::default())).collect();
        let library = |mishaps: &Mishaps| Arc::new(stumbling(environment.clone(), mishaps));
        let libraries = mishaps.iter().map(|(robot, mishaps)| (robot.clone(), library(mishaps))).collect();
        let (started, disks, put_in) = (Instant::now(), BTreeMap::new(), 0);
        FaultInjector(Rc::new(RefCell::new(Parts { started, seed, disks, put_in, rates, mishaps, libraries })))
    }

    /// Puts it into nodes.
    pub(super) fn adjust(&self) -> AdjustNode {
        let gear = self.clone();
        Box::new(move |settings| gear.equip(settings))
    }

    fn equip(&self, settings: &mut NodeSettings) {
        let node = settings.node.to_string();
        settings.store = self.disk(&node).store();
        let parts = self.0.borrow();
        let date = DATE_MS + u64::try_from(parts.started.elapsed().as_millis()).unwrap_or(u64::MAX);
        settings.clock = Clock::virtual_at(date).drifting(parts.rates.get(&node).copied().unwrap_or(1.0));
        if let (Some(robot), Some(library)) = (&mut settings.robot, parts.libraries.get(&node)) {
            robot.library = Arc::clone(library);
        }
    }

    /// A node's disk; a new one, if it has none.
    pub(super) fn disk(&self, node: &str) -> VirtualDisk {
        let mut parts = self.0.borrow_mut();
        let parts = &mut *parts;
        let new = || {
            parts.put_in += 1;
            VirtualDisk::new(parts.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(parts.put_in))
        };
        parts.disks.entry(node.to_owned()).or_insert_with(new).clone()
    }

    /// A node's disk is lost: its next life finds an empty one.
    pub(super) fn lose_disk(&self, node: &str) {
        self.0.borrow_mut().disks.remove(node);
    }

    /// A robot's skills go wrong so often.
    pub(super) fn inject_skill_fault(&self, robot: &str, how: SkillFault, times: u32) {
        if let Some(mishaps) = self.0.borrow().mishaps.get(robot) {
            let mut mishaps = mishaps.lock().unwrap_or_else(PoisonError::into_inner);
            mishaps.extend((0..times).map(|_| how));
        }
    }

    /// Nothing goes wrong with anybody's skills any more.
    pub(super) fn clear_skill_faults(&self) {
        for mishaps in self.0.borrow().mishaps.values() {
            mishaps.lock().unwrap_or_else(PoisonError::into_inner).clear();
        }
    }
}

/// The skills that come with Consort; before each is begun, something may go wrong.
fn stumbling(environment: Environment, mishaps: &Mishaps) -> SkillLibrary {
    let mut library = SkillLibrary::standard(environment);
    let mishaps = Arc::clone(mishaps);
    let added = library.extend(|registry| {
        registry.register(NodeManifest::new("Stumble", NodeKind::Action, []), move |_: &TaskContext| {
            Box::new(Stumble { mishaps: Arc::clone(&mishaps), until: None })
        })
    });
    added.expect("no other leaf is called so");
    for (task_type, mut tree) in SkillLibrary::standard_trees() {
        let Some(root) = tree.trees.remove(&tree.main) else { continue };
        let mut first = NodeSpec::new("Sequence");
        first.children = vec![NodeSpec::new("Stumble"), root];
        tree.trees.insert(tree.main.clone(), first);
        library.register(task_type, &tree).expect("a shipped tree with a leaf before it");
    }
    library
}

struct Stumble {
    mishaps: Mishaps,
    /// Until when it hangs.
    until: Option<WorldTime>,
}

impl Leaf for Stumble {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        if let Some(until) = self.until {
            let over = context.now() >= until;
            self.until = self.until.filter(|_| !over);
            return Ok(if over { NodeStatus::Success } else { NodeStatus::Running });
        }
        let mishap = self.mishaps.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
        match mishap {
            None => Ok(NodeStatus::Success),
            Some(SkillFault::Fails) => Err(Cause::new("chaos has it fail")),
            Some(SkillFault::Panics) => panic!("chaos has it panic"),
            Some(SkillFault::Hangs) => {
                self.until = Some(context.now() + Seconds::new(HANGS_S).map_err(|e| Cause::new(e.to_string()))?);
                Ok(NodeStatus::Running)
            }
        }
    }

    fn halt(&mut self, _: &mut LeafContext<'_, '_>) {
        self.until = None;
    }
}
