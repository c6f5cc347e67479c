//! The form of a map file, and the settings of an import.

/// Format of a map file, given by the ending of its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapFormat {
    /// Our own form as YAML: every other ending.
    Yaml,
    /// Our own form as JSON: `.json`.
    Json,
    /// A layout of the Layout Interchange Format: `.lif`, `.lif.json`.
    Layout,
    /// A drawing of diagrams.net: `.drawio`, `.xml`.
    Drawing,
    /// A building of Open-RMF: `.building.yaml`, `.building.yml`.
    Building,
}

impl MapFormat {
    /// Returns the format of a file with this name.
    pub fn of(file: &str) -> MapFormat {
        let name = file.to_ascii_lowercase();
        let ends = |endings: &[&str]| endings.iter().any(|ending| name.ends_with(ending));
        if ends(&[".drawio", ".xml"]) {
            MapFormat::Drawing
        } else if ends(&[".building.yaml", ".building.yml"]) {
            MapFormat::Building
        } else if ends(&[".lif", ".lif.json"]) {
            MapFormat::Layout
        } else if ends(&[".json"]) {
            MapFormat::Json
        } else {
            MapFormat::Yaml
        }
    }

    /// Checks whether the format is a drawing, an Open-RMF building or a layout.
    pub fn is_foreign(self) -> bool {
        matches!(self, MapFormat::Drawing | MapFormat::Building | MapFormat::Layout)
    }
}

/// Settings for content that a file does not define.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImportOptions {
    /// Metres per unit of a drawing, or per pixel of an Open-RMF building; above 0. Default: the
    /// scale in the file, and for a drawing without scale `METRES_PER_UNIT`.
    pub scale_m: Option<f64>,
    /// Navigation graph to read from an Open-RMF building. Default: all graphs; each lane then names its
    /// graphs, if there are several.
    pub graph: Option<i64>,
}
