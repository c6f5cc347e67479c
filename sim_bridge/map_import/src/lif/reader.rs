//! Reads a layout: levels, places, lanes and lifts.

use super::diagnostic::{ElementError, LifDiagnostic};
use super::raw::{Edge, EdgeProperties, File, Head, Layout, Node, Point};
use crate::drawing::{Drawing, round, to_map_name};
use crate::lanes;
use crate::read_error::ReadError;
use consort_world::map::{Facing, LaneEntry, LevelEntry, LiftEntry, PlaceEntry, PlaceKind};
use consort_world::suggest::did_you_mean;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

/// Tolerance of an orientation along the edge, in radians: files round pi to two digits.
const ALONG_RAD: f64 = 0.02;

/// Most errors with a suggestion: each compares a name with those of all nodes.
const HINTS_MAX: usize = 20;

/// Reads a layout; `name` is the name of the map if the file gives none.
pub(crate) fn read(text: &str, name: &str) -> Result<Drawing, ReadError<LifDiagnostic>> {
    let file: File = serde_json::from_str(text)
        .map_err(|error| other_version(text).unwrap_or_else(|| ReadError::Syntax(error.to_string())))?;
    let mut reader = Reader::of(&file);
    let project = file.meta_information.project_identification.as_deref().filter(|project| !project.is_empty());
    reader.drawing.map.name = to_map_name(project.unwrap_or(name));
    reader.check_file(&file);
    reader.levels();
    for layout in &file.layouts {
        reader.places(layout);
    }
    let edges = file.layouts.iter().flat_map(|layout| &layout.edges);
    let entries: Vec<LaneEntry> = edges.filter_map(|edge| reader.edge(edge)).collect();
    reader.drawing.map.lanes = lanes::join(entries);
    reader.lifts();
    reader.note_ignored(&file);
    if reader.diagnostics.is_empty() { Ok(reader.drawing) } else { Err(ReadError::Invalid(reader.diagnostics)) }
}

/// Returns the error for a file of another version: it may lack what version 1 requires.
fn other_version(text: &str) -> Option<ReadError<LifDiagnostic>> {
    let head: Head = serde_json::from_str(text).ok()?;
    Some(ReadError::Invalid(vec![version_problem(&head.meta_information.lif_version)?]))
}

fn version_problem(version: &str) -> Option<LifDiagnostic> {
    let error = ElementError::Version { version: version.to_owned() };
    let at = "metaInformation".to_owned();
    (version.split('.').next() != Some("1")).then_some(LifDiagnostic { at, error })
}

struct Reader<'a> {
    drawing: Drawing,
    diagnostics: Vec<LifDiagnostic>,
    /// Place, level and position of each node by its id.
    nodes: BTreeMap<&'a str, (String, &'a str, Point)>,
    /// Nodes at which vehicles interact with stations.
    stations: BTreeSet<&'a str>,
    /// Names of the levels, in the order of the file.
    levels: Vec<&'a str>,
    /// True if lanes name the types of vehicles.
    has_several_types: bool,
    /// The edges between levels, as pairs of places.
    rides: Vec<(String, String)>,
}

fn level_of(layout: &Layout) -> &str {
    layout.layout_level_id.as_deref().filter(|level| !level.is_empty()).unwrap_or(&layout.layout_id)
}

impl<'a> Reader<'a> {
    fn of(file: &'a File) -> Reader<'a> {
        let mut known = BTreeSet::new();
        let levels = file.layouts.iter().map(level_of).filter(|level| known.insert(*level)).collect();
        let layouts = || file.layouts.iter();
        let all = || layouts().flat_map(|layout| layout.nodes.iter().map(move |node| (layout, node)));
        let named = |node: &'a Node| node.node_name.as_deref().map(str::trim).filter(|name| !name.is_empty());
        let mut uses: BTreeMap<&str, usize> = BTreeMap::new();
        for name in all().flat_map(|(_, node)| [named(node), Some(node.node_id.as_str())]).flatten() {
            *uses.entry(name).or_default() += 1;
        }
        let place = |node: &'a Node| {
            // A name that equals the id of its own node occurs twice.
            let is_unique = |name: &&str| uses.get(name) == Some(&1) || *name == node.node_id;
            named(node).filter(is_unique).unwrap_or(&node.node_id).to_owned()
        };
        let types = layouts().flat_map(|layout| &layout.edges).flat_map(|edge| &edge.vehicle_type_edge_properties);
        let types: BTreeSet<&str> = types.map(|properties| properties.vehicle_type_id.as_str()).collect();
        let stations = layouts().flat_map(|layout| &layout.stations).flat_map(|station| &station.interaction_node_ids);
        Reader {
            drawing: Drawing::default(),
            diagnostics: Vec::new(),
            nodes: all()
                .map(|(layout, node)| (node.node_id.as_str(), (place(node), level_of(layout), node.node_position)))
                .collect(),
            stations: stations.map(String::as_str).collect(),
            levels,
            has_several_types: types.len() > 1,
            rides: Vec::new(),
        }
    }

    fn report(&mut self, at: String, error: ElementError) {
        self.diagnostics.push(LifDiagnostic { at, error });
    }

    fn check_file(&mut self, file: &File) {
        self.diagnostics.extend(version_problem(&file.meta_information.lif_version));
        for (what, is_empty) in [("layouts", file.layouts.is_empty()), ("nodes", self.nodes.is_empty())] {
            if is_empty {
                return self.report("file".to_owned(), ElementError::Empty { what });
            }
        }
        let mut seen = BTreeSet::new();
        for node in file.layouts.iter().flat_map(|layout| &layout.nodes) {
            if !seen.insert(&node.node_id) {
                self.report(format!("node {:?}", node.node_id), ElementError::DuplicateNode);
            }
        }
        for layout in &file.layouts {
            let at = format!("layout {:?}", layout.layout_id);
            for node in layout.stations.iter().flat_map(|station| &station.interaction_node_ids) {
                self.node(&at, "interactionNodeIds", node);
            }
        }
    }

    /// Adds the levels, if there are several.
    fn levels(&mut self) {
        if self.levels.len() > 1 {
            let level = |name: &&str| LevelEntry { name: (*name).to_owned(), ..LevelEntry::default() };
            self.drawing.map.levels = self.levels.iter().map(level).collect();
            self.drawing.notes.push("layouts have no elevations: all levels are at 0 m".to_owned());
        }
    }

    fn places(&mut self, layout: &Layout) {
        for node in &layout.nodes {
            let Some((name, level, at)) = self.nodes.get(node.node_id.as_str()) else { continue };
            let mut properties = node.vehicle_type_node_properties.iter();
            let mut actions = properties.clone().flat_map(|of_type| &of_type.actions);
            let charges = actions.any(|action| action.action_type == "startCharging");
            let kind = match (charges, self.stations.contains(node.node_id.as_str())) {
                (true, _) => PlaceKind::Charger,
                (false, true) => PlaceKind::Other,
                (false, false) => PlaceKind::Corridor,
            };
            self.drawing.map.places.push(PlaceEntry {
                name: name.clone(),
                kind,
                x_m: round(at.x),
                y_m: round(at.y),
                yaw_rad: properties.find_map(|of_type| of_type.theta).map_or(0.0, round),
                level: (self.levels.len() > 1).then(|| (*level).to_owned()),
                dock: charges.then(|| node.node_id.clone()),
            });
        }
    }

    /// Returns the place, level and position of a node.
    fn node(&mut self, at: &str, field: &'static str, id: &str) -> Option<(String, &'a str, Point)> {
        let found = self.nodes.get(id).cloned();
        if found.is_none() {
            let suggests = self.diagnostics.len() < HINTS_MAX;
            let hint = if suggests { did_you_mean(id, self.nodes.keys().copied()) } else { String::new() };
            self.report(at.to_owned(), ElementError::UnknownNode { field, node: id.to_owned(), hint });
        }
        found
    }

    /// Returns the lane of an edge within a level. An edge between two levels becomes a ride by lift.
    fn edge(&mut self, edge: &Edge) -> Option<LaneEntry> {
        let at = format!("edge {:?}", edge.edge_id);
        let start = self.node(&at, "startNodeId", &edge.start_node_id);
        let end = self.node(&at, "endNodeId", &edge.end_node_id);
        let types = &edge.vehicle_type_edge_properties;
        if types.is_empty() {
            self.report(at, ElementError::NoVehicleTypes);
            return None;
        }
        let ((from, from_level, start), (to, to_level, end)) = start.zip(end)?;
        if from_level != to_level {
            self.rides.push((from, to));
            return None;
        }
        let graphs = types.iter().filter(|_| self.has_several_types).map(|of_type| of_type.vehicle_type_id.clone());
        let headings: BTreeSet<Option<bool>> = types.iter().map(is_forward).collect();
        let heading = headings.first().copied().flatten().filter(|_| headings.len() == 1);
        Some(LaneEntry {
            between: (from, to),
            length_m: types.iter().filter_map(|of_type| curve_length(of_type, start, end)).reduce(f64::max),
            one_way: true,
            speed_limit_mps: types.iter().filter_map(|of_type| of_type.max_speed).reduce(f64::min),
            facing: heading.map(|is_forward| if is_forward { Facing::Forward } else { Facing::Backward }),
            graphs: graphs.collect(),
        })
    }

    /// Adds a lift for each group of places with edges between levels.
    fn lifts(&mut self) {
        let mut groups: Vec<BTreeSet<String>> = Vec::new();
        for (from, to) in std::mem::take(&mut self.rides) {
            let (joined, others): (Vec<_>, Vec<_>) =
                groups.into_iter().partition(|group| group.contains(&from) || group.contains(&to));
            groups = others;
            groups.push(joined.into_iter().flatten().chain([from, to]).collect());
        }
        for (number, stops) in groups.into_iter().enumerate() {
            let name = format!("Lift {}", number + 1);
            let stops: Vec<String> = stops.into_iter().collect();
            let stops_text = stops.join(", ");
            self.drawing.notes.push(format!(
                "{name:?} stands for the edges between the levels at {stops_text}: vehicles of all types ride in \
                 both directions"
            ));
            self.drawing.map.lifts.push(LiftEntry { name, stops, ..LiftEntry::default() });
        }
    }

    /// Adds a note for each ignored kind of content.
    fn note_ignored(&mut self, file: &File) {
        let edges = file.layouts.iter().flat_map(|layout| &layout.edges);
        let types: Vec<&EdgeProperties> = edges.flat_map(|edge| &edge.vehicle_type_edge_properties).collect();
        let mut note = |count: usize, what: &str| {
            if count > 0 {
                self.drawing.notes.push(format!("{what} of {count} edge(s) are ignored"));
            }
        };
        note(types.iter().filter(|of_type| of_type.load_restriction.is_some()).count(), "restrictions of loads");
        note(types.iter().filter(|of_type| of_type.max_height.is_some()).count(), "limits of the height");
        note(types.iter().filter(|of_type| !of_type.actions.is_empty()).count(), "actions");
    }
}

/// Returns whether a vehicle drives forward on an edge; `None` if it may turn, or has another orientation.
fn is_forward(properties: &EdgeProperties) -> Option<bool> {
    let orientation = properties.vehicle_orientation?;
    if properties.orientation_type.as_deref() == Some("GLOBAL") {
        return None;
    }
    let near = |angle: f64| (orientation.abs() - angle).abs() <= ALONG_RAD;
    if near(0.0) || near(2.0 * PI) { Some(true) } else { near(PI).then_some(false) }
}

/// Returns the length of the control polygon of a trajectory: the curve is never longer. At least the straight line, and
/// `None` for an edge without a trajectory.
fn curve_length(properties: &EdgeProperties, start: Point, end: Point) -> Option<f64> {
    let points = &properties.trajectory.as_ref().filter(|curve| !curve.control_points.is_empty())?.control_points;
    let corners: Vec<Point> = [start].into_iter().chain(points.iter().copied()).chain([end]).collect();
    Some(corners.windows(2).map(|pair| (pair[0].x - pair[1].x).hypot(pair[0].y - pair[1].y)).sum())
}
