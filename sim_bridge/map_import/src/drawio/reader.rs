//! Reads a drawing: its scale, and its pages one after the other.

use super::conventions::METRES_PER_UNIT;
use super::diagnostic::{CellError, DrawioDiagnostic};
use super::page::{DrawingContent, POSITIVE, PageReader};
use super::shape;
use super::xml::{self, Page};
use crate::drawing::Drawing;
use crate::read_error::ReadError;
use crate::settings::ImportOptions;

/// Reads a drawing; `name` becomes the name of the map.
pub(crate) fn read(text: &str, name: &str, options: &ImportOptions) -> Result<Drawing, ReadError<DrawioDiagnostic>> {
    let mut diagnostics = Vec::new();
    let pages = xml::pages(text, &mut diagnostics).map_err(|error| ReadError::Syntax(error.to_string()))?;
    let mut reader = DrawingContent { diagnostics, ..DrawingContent::default() };
    reader.drawing.map.name = name.to_owned();
    let (used, empty): (Vec<&Page>, Vec<&Page>) = pages.iter().partition(|page| is_level(page));
    for page in empty {
        reader.drawing.notes.push(format!("page {:?} has neither walls nor typed cells: ignored", page.name));
    }
    let scale = scale(&used, options, &mut reader);
    for page in &used {
        let level = (used.len() > 1).then(|| page.name.clone());
        PageReader::new(page, level, scale, &mut reader).read();
    }
    let DrawingContent { mut drawing, diagnostics, lifts } = reader;
    if !diagnostics.is_empty() {
        return Err(ReadError::Invalid(diagnostics));
    }
    drawing.map.lifts = lifts.into_values().collect();
    drawing.assign_nearest_places();
    Ok(drawing)
}

fn is_level(page: &Page) -> bool {
    let cells = shape::index(page);
    page.cells.iter().any(|cell| cell.data.contains_key("type") || shape::wall(cell, &cells).is_some())
}

/// Returns the metres per unit: from the options, else from the first page with a scale, else the
/// default.
fn scale(pages: &[&Page], options: &ImportOptions, reader: &mut DrawingContent) -> f64 {
    let written_scale = pages.iter().find_map(|page| {
        let cell = page.cells.iter().find(|cell| cell.data.contains_key("metres_per_unit"))?;
        Some((page, cell, &cell.data["metres_per_unit"]))
    });
    if let Some(scale) = options.scale_m {
        return scale;
    }
    let Some((page, cell, text)) = written_scale else {
        let note = format!("the drawing has no scale: using {METRES_PER_UNIT} m per unit");
        reader.drawing.notes.push(note);
        return METRES_PER_UNIT;
    };
    let scale = text.parse().ok().filter(|scale: &f64| *scale > 0.0 && scale.is_finite());
    scale.unwrap_or_else(|| {
        let error = CellError::Number { field: "metres_per_unit".into(), text: text.clone(), allowed: POSITIVE };
        reader.diagnostics.push(DrawioDiagnostic { page: page.name.clone(), cell: cell.id.clone(), error });
        METRES_PER_UNIT
    })
}
