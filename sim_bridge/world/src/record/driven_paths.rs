//! The paths of robots, drawn over the map when the recording ends.

use super::sink::{RecordError, RecordingSink, WorldChanges};
use crate::map::LevelIndex;
use crate::map::render::{DrawnItem, Trail, svg_with_trails};
use crate::world::{MotionState, World};
use consort_protocol::ids::RobotId;
use consort_skills::actions::RobotBackend;
use consort_text::count;
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};

/// Greatest distance between a drawn path and the robot's position, in metres.
const TOLERANCE_M: f64 = 0.02;

/// Number of points checked together for lying on a line. A long straight keeps more corners than
/// necessary, but the work per point stays bounded.
const RUN: usize = 64;

/// Corners kept of a robot's path, about a day of driving in a ward. Older corners are dropped.
const CORNERS_MAX: usize = 20_000;

/// See the [module](self).
pub(super) struct DrivenPathsSink {
    file: PathBuf,
    paths: BTreeMap<RobotId, DrivenPath>,
}

#[derive(Default)]
struct DrivenPath {
    /// Parts of the path between lift rides.
    sections: VecDeque<(LevelIndex, VecDeque<(f64, f64)>)>,
    /// Positions since the last corner.
    since: Vec<(f64, f64)>,
    corners: usize,
    length_m: f64,
}

impl DrivenPathsSink {
    pub(super) fn create(file: &Path) -> Result<DrivenPathsSink, RecordError> {
        // Fail now rather than at the end.
        std::fs::write(file, "").map_err(RecordError::of(file))?;
        Ok(DrivenPathsSink { file: file.to_owned(), paths: BTreeMap::new() })
    }

    /// Returns all paths and clears them.
    pub(super) fn trails(&mut self) -> Vec<Trail> {
        let paths = std::mem::take(&mut self.paths);
        paths.into_iter().filter_map(|(robot, path)| path.into_trail(&robot)).collect()
    }

    fn extend(&mut self, positions: impl Iterator<Item = MotionState>) {
        for position in positions {
            let point = (position.pose.x, position.pose.y);
            self.paths.entry(position.robot).or_default().drive_to(position.level, point);
        }
    }
}

impl DrivenPath {
    fn drive_to(&mut self, level: LevelIndex, to: (f64, f64)) {
        let Some((_, corners)) = self.sections.back_mut().filter(|(here, _)| *here == level) else {
            self.corner();
            self.sections.push_back((level, [to].into()));
            self.corners += 1;
            return;
        };
        let from = self.since.last().or(corners.back()).copied().unwrap_or(to);
        if from == to {
            return;
        }
        self.length_m += apart(from, to);
        let corner = corners.back().copied().unwrap_or(to);
        let straight = self.since.len() < RUN && self.since.iter().all(|on| off_line(*on, corner, to) <= TOLERANCE_M);
        if !straight {
            self.corner();
        }
        self.since.push(to);
    }

    /// Makes the last position a corner.
    fn corner(&mut self) {
        let Some(last) = self.since.last().copied() else { return };
        self.since.clear();
        if let Some((_, corners)) = self.sections.back_mut() {
            corners.push_back(last);
            self.corners += 1;
        }
        while self.corners > CORNERS_MAX
            && let Some((_, oldest)) = self.sections.front_mut()
        {
            oldest.pop_front();
            self.corners -= 1;
            if oldest.is_empty() {
                self.sections.pop_front();
            }
        }
    }

    fn into_trail(mut self, robot: &RobotId) -> Option<Trail> {
        self.corner();
        let sections = self.sections.into_iter().map(|(level, corners)| (level, corners.into())).collect();
        (self.length_m > 0.0).then(|| Trail { name: robot.to_string(), segments: sections, length_m: self.length_m })
    }
}

impl RecordingSink for DrivenPathsSink {
    fn begin(&mut self, world: &World) -> Result<(), RecordError> {
        self.extend(world.motion_states());
        Ok(())
    }

    fn write_changes(&mut self, _: &World, changes: &WorldChanges<'_>) -> Result<(), RecordError> {
        self.extend(changes.moved.iter().cloned());
        Ok(())
    }

    fn on_time_advanced(&mut self, _: f64) -> Result<(), RecordError> {
        Ok(())
    }

    fn end(&mut self, world: &World) -> Result<String, RecordError> {
        let trails = self.trails();
        let bodies = bodies(world);
        let caption = format!("paths driven in {:.0} s", world.now().as_secs());
        let svg = svg_with_trails(world.map(), &bodies.iter().collect::<Vec<_>>(), &trails, &caption);
        std::fs::write(&self.file, svg).map_err(RecordError::of(&self.file))?;
        let driven_m = trails.iter().fold(0.0, |driven_m, trail| driven_m + trail.length_m);
        let robots = count(trails.len(), "robot", "robots");
        Ok(format!("{}: {driven_m:.0} m driven by {robots}", self.file.display()))
    }
}

/// Robots and people at their current positions.
fn bodies(world: &World) -> Vec<DrawnItem> {
    let map = world.map();
    let robots = world.motion_states().map(|position| {
        let wide = world.robot_setup(&position.robot).map_or(0.0, |body| 2.0 * body.radius_m);
        DrawnItem {
            kind: "robot".to_owned(),
            name: position.robot.to_string(),
            level: Some(map.level(position.level).name.clone()),
            x_m: position.pose.x,
            y_m: position.pose.y,
            yaw_rad: position.pose.yaw,
            size_m: (wide, wide),
            ..DrawnItem::default()
        }
    });
    let people = world.people().into_iter().filter(|person| !person.away).filter_map(|person| {
        let place = map.place(&person.place)?;
        Some(DrawnItem {
            kind: "person".to_owned(),
            name: person.name.to_string(),
            level: Some(map.level(place.level).name.clone()),
            x_m: place.pose.x,
            y_m: place.pose.y,
            size_m: (0.4, 0.4),
            ..DrawnItem::default()
        })
    });
    // Robots last: they are drawn over the people next to them.
    people.chain(robots).collect()
}

fn apart(a: (f64, f64), b: (f64, f64)) -> f64 {
    (b.0 - a.0).hypot(b.1 - a.1)
}

/// Distance of a point from the line between two others.
fn off_line(point: (f64, f64), a: (f64, f64), b: (f64, f64)) -> f64 {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let square = dx * dx + dy * dy;
    let along = if square > 0.0 { ((point.0 - a.0) * dx + (point.1 - a.1) * dy) / square } else { 0.0 };
    let along = along.clamp(0.0, 1.0);
    apart(point, (a.0 + along * dx, a.1 + along * dy))
}
