//! Conversion of SVG to PNG, with an embedded font: the same image on every machine.

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};
use std::sync::Arc;

/// A PNG could not be made. None of these errors occurs for a drawing of a map.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PngError {
    /// The text is not SVG.
    #[error("the text is not an SVG image: {0}")]
    Svg(String),
    /// The image does not fit in memory.
    #[error("an image of {width} x {height} pixels does not fit in memory")]
    Size {
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
    },
    /// The pixels cannot be encoded.
    #[error("the image cannot be encoded: {0}")]
    Encoding(String),
}

/// Converts an SVG to a PNG.
///
/// # Errors
/// [`PngError`] if the text is not SVG, or the image does not fit in memory.
pub(crate) fn png(svg: &str) -> Result<Vec<u8>, PngError> {
    let mut fonts = fontdb::Database::new();
    fonts.load_font_data(epaint_default_fonts::HACK_REGULAR.to_vec());
    fonts.set_monospace_family("Hack");
    let options = Options { fontdb: Arc::new(fonts), ..Options::default() };
    let tree = Tree::from_str(svg, &options).map_err(|error| PngError::Svg(error.to_string()))?;
    let size = tree.size().to_int_size();
    let (width, height) = (size.width(), size.height());
    let mut pixels = Pixmap::new(width, height).ok_or(PngError::Size { width, height })?;
    resvg::render(&tree, Transform::identity(), &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| PngError::Encoding(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::png;
    use consort_world::map::{read, render};
    use resvg::tiny_skia::Pixmap;

    #[test]
    fn a_drawn_map_is_not_blank() {
        let text = "{name: one, places: [{name: A, kind: room, x_m: 5, y_m: 5}]}";
        let svg = render::svg(&read(text, "one.yaml").unwrap(), &[]);
        let pixels = Pixmap::decode_png(&png(&svg).unwrap()).unwrap();
        let coloured =
            pixels.pixels().iter().filter(|pixel| (pixel.red(), pixel.green(), pixel.blue()) != (255, 255, 255));
        let share = coloured.count() as f64 / pixels.pixels().len() as f64;
        assert!((0.005..0.5).contains(&share), "{share} of the image is drawn on");
    }

    #[test]
    fn a_png_has_the_size_of_the_svg_and_letters() {
        let text = "<text y='15' font-family='Hack, monospace'>A</text>";
        let svg = |text: &str| format!("<svg xmlns='http://www.w3.org/2000/svg' width='80' height='20'>{text}</svg>");
        let (with, without) = (png(&svg(text)).unwrap(), png(&svg("")).unwrap());
        assert_ne!(with, without);
        let pixels = Pixmap::decode_png(&with).unwrap();
        assert_eq!((pixels.width(), pixels.height()), (80, 20));
    }

    #[test]
    fn a_text_that_is_not_svg_is_rejected() {
        assert!(png("no").unwrap_err().to_string().starts_with("the text is not an SVG image: "));
    }
}
