//! The points of a path, as written in the parameter `waypoints` of a task.

/// The text is not a path.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum WaypointError {
    /// A text is not a point.
    #[error("{text:?} is not a point: allowed is `x,y` in metres")]
    NotAPoint {
        /// The text.
        text: String,
    },
    /// A path has at least a single point.
    #[error("there are no waypoints to follow")]
    Empty,
}

/// Parses points: `x,y` in metres, at least a single point.
///
/// # Errors
/// [`WaypointError`] for the first text that is not a point, or if there is none.
pub(crate) fn parse_points<'t>(texts: impl Iterator<Item = &'t str>) -> Result<Vec<(f64, f64)>, WaypointError> {
    let point = |text: &str| {
        let (x, y) = text.split_once(',')?;
        let number = |text: &str| text.trim().parse().ok().filter(|number: &f64| number.is_finite());
        Some((number(x)?, number(y)?))
    };
    let read = |text: &str| point(text).ok_or_else(|| WaypointError::NotAPoint { text: text.to_owned() });
    let points: Vec<(f64, f64)> = texts.map(read).collect::<Result<_, _>>()?;
    if points.is_empty() { Err(WaypointError::Empty) } else { Ok(points) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_has_points_and_an_error_names_the_text() {
        let read = |texts: &[&str]| parse_points(texts.iter().copied());
        assert_eq!(read(&["6.0, 2.5", "7.5,3"]), Ok(vec![(6.0, 2.5), (7.5, 3.0)]));
        let wrong = read(&["6.0,2.5", "inf,1"]).unwrap_err();
        assert_eq!(wrong.to_string(), "\"inf,1\" is not a point: allowed is `x,y` in metres");
        assert_eq!(read(&[]).unwrap_err().to_string(), "there are no waypoints to follow");
    }
}
