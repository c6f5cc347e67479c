//! The leaf that computes the headings along a path.
//!
//! The points are `x,y` in metres, separated by `;`: `6.0,2.5; 7.5,3.0`. The robot faces along the
//! path. After a halt, the skill starts again with the first point.

use super::context::TaskContext;
use crate::bt::{
    Cause, LeafContext, NodeKind, NodeManifest, PortSpec, PortType, Registry, RegistryError, SyncLeaf, Value,
};
use crate::waypoints::parse_points;
use consort_protocol::pose::Pose;

pub(super) fn register_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    // Conversion of points to poses: no goal is sent, so the leaf completes at once.
    let ports = [PortSpec::input("points", PortType::List), PortSpec::output("poses", PortType::List)];
    registry.register(NodeManifest::new("ComputePathHeadings", NodeKind::Action, ports), |_: &TaskContext| {
        Box::new(SyncLeaf(|leaf: &mut LeafContext<'_, '_>| {
            let texts: Vec<String> = leaf.read::<Vec<Value>>("points")?.iter().map(Value::to_string).collect();
            let points =
                parse_points(texts.iter().map(String::as_str)).map_err(|error| Cause::new(error.to_string()))?;
            let here = leaf.actions().telemetry().map(|telemetry| telemetry.pose);
            leaf.write("poses", heading_along(&points, here).into_iter().map(Value::Pose).collect::<Vec<_>>())?;
            Ok(true)
        }))
    })
}

/// Returns poses at the points, each facing the next point. The last pose keeps the direction of
/// arrival, from `here` if it is the only point.
fn heading_along(points: &[(f64, f64)], here: Option<Pose>) -> Vec<Pose> {
    let pose = |(index, (x, y)): (usize, &(f64, f64))| {
        let before = index.checked_sub(1).map(|index| points[index]).or(here.map(|pose| (pose.x, pose.y)));
        let (dx, dy) = match points.get(index + 1) {
            Some((next_x, next_y)) => (next_x - x, next_y - y),
            None => before.map_or((0.0, 0.0), |(before_x, before_y)| (x - before_x, y - before_y)),
        };
        Pose::new(*x, *y, dy.atan2(dx))
    };
    points.iter().enumerate().map(pose).collect()
}
