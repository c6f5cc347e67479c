//! Reads the cells of a drawing file: its pages, plain or deflated, and the content of each cell.

use super::diagnostic::{CellError, DrawioDiagnostic};
use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use consort_skills::xml::{self, XmlError};
use flate2::read::DeflateDecoder;
use percent_encoding::percent_decode;
use roxmltree::Node;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;

/// Greatest absolute coordinate of a drawing, in units.
const EXTENT: f64 = 1e7;
/// Total size of the compressed pages of a drawing after inflating, in bytes.
pub(super) const INFLATED_BYTES: usize = 32 << 20;
/// Nodes of a page: elements, and the texts between them. Each node takes about 50 bytes.
const XML_NODES: u32 = 1_000_000;

/// The text is not a drawing.
#[derive(Debug, thiserror::Error)]
pub(super) enum DrawingError {
    #[error("the file is not XML: {0}")]
    Xml(XmlError),
    #[error("the file is not a drawing: its root is <{0}>, allowed are <mxfile> and <mxGraphModel>")]
    Root(String),
    #[error("the drawing has no pages: <mxfile> contains no <diagram>")]
    NoPages,
    #[error("page {name:?}: {error}")]
    Page { name: String, error: PageError },
}

/// A page cannot be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum PageError {
    #[error("it contains neither <mxGraphModel> nor compressed text")]
    Empty,
    #[error("its compressed text is not base64: {0}")]
    Base64(base64::DecodeError),
    #[error("its compressed text cannot be inflated: {0}")]
    Deflate(std::io::Error),
    #[error("the compressed pages inflate to more than the {INFLATED_BYTES} bytes allowed")]
    TooLarge,
    #[error("its inflated content is not UTF-8: {0}")]
    Utf8(std::str::Utf8Error),
    #[error("its inflated content is not XML: {0}")]
    Xml(XmlError),
    #[error("its inflated content is <{0}>, allowed: <mxGraphModel>")]
    Root(String),
}

/// A page of the drawing.
#[derive(Debug)]
pub(super) struct Page {
    pub(super) name: String,
    /// Height in units; 0 if not given.
    pub(super) height: f64,
    pub(super) cells: Vec<Cell>,
}

/// A cell: a shape, a line, a layer, or the page itself.
#[derive(Debug, Default)]
pub(super) struct Cell {
    pub(super) id: String,
    /// Its data in diagrams.net, without id and label.
    pub(super) data: BTreeMap<String, String>,
    /// Its label as plain text.
    pub(super) label: String,
    pub(super) style: BTreeMap<String, String>,
    pub(super) parent: Option<String>,
    pub(super) source: Option<String>,
    pub(super) target: Option<String>,
    pub(super) is_line: bool,
    pub(super) geometry: Option<Geometry>,
}

/// Position of a cell relative to its parent, in units; y points down.
#[derive(Debug, Default, Clone)]
pub(super) struct Geometry {
    pub(super) at: (f64, f64),
    pub(super) size: (f64, f64),
    /// True if `at` is a fraction of the parent's size.
    pub(super) relative: bool,
    pub(super) source: Option<(f64, f64)>,
    pub(super) target: Option<(f64, f64)>,
    pub(super) points: Vec<(f64, f64)>,
}

/// Returns all pages. Errors of single cells are added to `diagnostics`.
///
/// # Errors
/// [`DrawingError`], with line and column where known.
pub(super) fn pages(text: &str, diagnostics: &mut Vec<DrawioDiagnostic>) -> Result<Vec<Page>, DrawingError> {
    let document = xml::parse(text, XML_NODES).map_err(DrawingError::Xml)?;
    let root = document.root_element();
    let mut left = INFLATED_BYTES;
    match root.tag_name().name() {
        "mxGraphModel" => Ok(vec![page("Page-1", root, diagnostics)]),
        "mxfile" => {
            let diagrams = root.children().filter(|node| node.has_tag_name("diagram")).enumerate();
            let pages: Result<Vec<Page>, DrawingError> = diagrams
                .map(|(index, diagram)| {
                    let name = diagram.attribute("name").map_or_else(|| format!("Page-{}", index + 1), str::to_owned);
                    diagram_of(&name, diagram, &mut left, diagnostics)
                        .map_err(|error| DrawingError::Page { name, error })
                })
                .collect();
            match pages {
                Ok(pages) if pages.is_empty() => Err(DrawingError::NoPages),
                pages => pages,
            }
        }
        other => Err(DrawingError::Root(other.to_owned())),
    }
}

fn diagram_of(
    name: &str,
    diagram: Node,
    left: &mut usize,
    diagnostics: &mut Vec<DrawioDiagnostic>,
) -> Result<Page, PageError> {
    if let Some(model) = diagram.children().find(|node| node.has_tag_name("mxGraphModel")) {
        return Ok(page(name, model, diagnostics));
    }
    let text = inflate(diagram.text().unwrap_or_default(), left)?;
    let document = xml::parse(&text, XML_NODES).map_err(PageError::Xml)?;
    let root = document.root_element();
    if !root.has_tag_name("mxGraphModel") {
        return Err(PageError::Root(root.tag_name().name().to_owned()));
    }
    Ok(page(name, root, diagnostics))
}

/// Inflates a compressed page: percent-encoded, deflated without a header, in base64.
fn inflate(text: &str, left: &mut usize) -> Result<String, PageError> {
    let lenient = GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
    let packed: String = text.split_whitespace().collect();
    if packed.is_empty() {
        return Err(PageError::Empty);
    }
    let packed = GeneralPurpose::new(&STANDARD, lenient).decode(packed).map_err(PageError::Base64)?;
    let mut encoded = Vec::new();
    let mut limited = DeflateDecoder::new(packed.as_slice()).take(*left as u64 + 1);
    limited.read_to_end(&mut encoded).map_err(PageError::Deflate)?;
    *left = left.checked_sub(encoded.len()).ok_or(PageError::TooLarge)?;
    Ok(percent_decode(&encoded).decode_utf8().map_err(PageError::Utf8)?.into_owned())
}

fn page(name: &str, model: Node, diagnostics: &mut Vec<DrawioDiagnostic>) -> Page {
    let root = model.children().find(|node| node.has_tag_name("root"));
    let mut reader = Reader { page: name, diagnostics, seen: BTreeSet::new() };
    let cells: Vec<Cell> =
        root.into_iter().flat_map(|root| root.children()).filter_map(|node| reader.cell(node)).collect();
    let height =
        model.attribute("pageHeight").and_then(|text| text.parse().ok()).filter(|height: &f64| height.is_finite());
    Page { name: name.to_owned(), height: height.unwrap_or(0.0), cells }
}

struct Reader<'a> {
    page: &'a str,
    diagnostics: &'a mut Vec<DrawioDiagnostic>,
    seen: BTreeSet<String>,
}

impl Reader<'_> {
    fn cell(&mut self, node: Node) -> Option<Cell> {
        // A cell with data of its own is wrapped in an element with the data.
        let (data, inner) = match node.tag_name().name() {
            "mxCell" => (None, node),
            "object" | "UserObject" => (Some(node), node.children().find(|child| child.has_tag_name("mxCell"))?),
            _ => return None,
        };
        let holder = data.unwrap_or(inner);
        let text = |name| inner.attribute(name).map(str::to_owned);
        let id = holder.attribute("id").unwrap_or_default().to_owned();
        if !id.is_empty() && !self.seen.insert(id.clone()) {
            self.report(&id, CellError::Duplicate);
        }
        let label = holder.attribute("label").or(inner.attribute("value")).unwrap_or_default();
        let data = data.into_iter().flat_map(|node| node.attributes());
        let data = data.filter(|attribute| !matches!(attribute.name(), "id" | "label"));
        let geometry = inner.children().find(|child| child.has_tag_name("mxGeometry"));
        Some(Cell {
            data: data.map(|attribute| (attribute.name().to_owned(), attribute.value().to_owned())).collect(),
            label: plain(label),
            style: style(inner.attribute("style").unwrap_or_default()),
            parent: text("parent"),
            source: text("source"),
            target: text("target"),
            is_line: inner.attribute("edge") == Some("1"),
            geometry: geometry.map(|node| self.geometry(&id, node)),
            id,
        })
    }

    fn geometry(&mut self, id: &str, node: Node) -> Geometry {
        let mut geometry = Geometry {
            at: (self.number(id, node, "x"), self.number(id, node, "y")),
            size: (self.number(id, node, "width"), self.number(id, node, "height")),
            relative: node.attribute("relative") == Some("1"),
            ..Geometry::default()
        };
        for child in node.children().filter(Node::is_element) {
            let role = child.attribute("as");
            if child.has_tag_name("Array") && role == Some("points") {
                let points = child.children().filter(|point| point.has_tag_name("mxPoint"));
                geometry.points = points.map(|point| self.point(id, point)).collect();
            } else if child.has_tag_name("mxPoint") && role == Some("sourcePoint") {
                geometry.source = Some(self.point(id, child));
            } else if child.has_tag_name("mxPoint") && role == Some("targetPoint") {
                geometry.target = Some(self.point(id, child));
            }
        }
        geometry
    }

    fn point(&mut self, id: &str, node: Node) -> (f64, f64) {
        (self.number(id, node, "x"), self.number(id, node, "y"))
    }

    /// Returns a coordinate; 0 if it is not written, as the format defines.
    fn number(&mut self, id: &str, node: Node, field: &str) -> f64 {
        let Some(text) = node.attribute(field) else { return 0.0 };
        match text.trim().parse::<f64>() {
            Ok(number) if number.abs() <= EXTENT => number,
            _ => {
                let (field, text) = (field.to_owned(), text.to_owned());
                let allowed = "a number from -10000000 to 10000000";
                self.report(id, CellError::Number { field, text, allowed });
                0.0
            }
        }
    }

    fn report(&mut self, cell: &str, error: CellError) {
        self.diagnostics.push(DrawioDiagnostic { page: self.page.to_owned(), cell: cell.to_owned(), error });
    }
}

/// Splits `shape=x;rotation=90;html` into keys and values; a word without a value becomes a key.
fn style(text: &str) -> BTreeMap<String, String> {
    let items = text.split(';').map(str::trim).filter(|item| !item.is_empty());
    items
        .map(|item| match item.split_once('=') {
            Some((key, value)) => (key.to_owned(), value.to_owned()),
            None => (item.to_owned(), String::new()),
        })
        .collect()
}

/// Removes the markup of a label: labels of diagrams.net are HTML.
fn plain(label: &str) -> String {
    let mut text = String::new();
    let mut rest = label;
    while let Some((before, markup)) = rest.split_once('<') {
        text.push_str(before);
        text.push(' ');
        rest = markup.split_once('>').map_or("", |(_, after)| after);
    }
    text.push_str(rest);
    let text = text.replace("&nbsp;", " ").replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
