//! Drawings of maps: SVG, and PNG made of it.
//!
//! Each level has a panel. All panels have the same scale and the same origin. North is up.

pub(crate) mod colours;
mod content;
mod document;
mod elements;
mod labels;
mod level;
mod page;
mod png;
#[cfg(test)]
mod tests;
mod trails;

pub use content::DrawnItem;
pub(crate) use content::Trail;
pub use document::svg;
pub(crate) use document::svg_with_trails;
pub use png::{PngError, png};
