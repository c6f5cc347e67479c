//! Drawings of maps: SVG.
//!
//! Each level has a panel. All panels have the same scale and the same origin. North is up.

pub(crate) mod colours;
mod content;
mod document;
mod elements;
mod labels;
mod level;
mod page;
#[cfg(test)]
mod tests;
mod trails;

pub use content::DrawnItem;
pub(crate) use content::Trail;
pub use document::svg;
pub(crate) use document::svg_with_trails;
