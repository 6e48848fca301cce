//! Small pictures in the lines of tables, beside their numbers. They are drawn only on web pages, not in files.

use crate::look::{Style, TextStyle, stage};
use crate::plot::{At, Item, Label, Path};
use peernet_statistics::number;

/// Length of a share bar that shows the share 1, as a share of the picture. The rest of the picture is room for the
/// number after the bar.
const FULL_LENGTH: f64 = 0.72;
/// Distance from a share bar to its number, as a share of the picture.
const NUMBER_DISTANCE: f64 = 0.02;
/// Minimum length of a meter's bar as a share of the picture, so that a small share is visible.
const MIN_LENGTH: f64 = 0.02;

/// Returns a bar that shows the share of a stage, 0 to 1, with the share as a number after the bar.
pub fn share_bar(name: &str, share: f64) -> Vec<Item> {
    let end = share.clamp(0.0, 1.0) * FULL_LENGTH;
    let number_at = At::new(end + NUMBER_DISTANCE, 0.5);
    let number = Label::new(number_at, number::share(share), TextStyle::AXIS);
    vec![Item::rect(At::new(0.0, 0.19), At::new(end, 0.81), stage(name).plain()), Item::Text(number)]
}

/// Returns a meter that shows the used share of a limit, 0 to 1. The meter is a bar on a track that ends at the limit.
pub fn meter(share: f64) -> Vec<Item> {
    // A share of a limit of zero is not finite.
    let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
    let end = if share > 0.0 { share.max(MIN_LENGTH) } else { 0.0 };
    let bar = |end, class| Item::rect(At::new(0.0, 0.0), At::new(end, 1.0), Style::of_page(class));
    vec![bar(1.0, "track"), bar(end, "fill")]
}

/// Returns a line through values from 0 to 1 at evenly spaced times, with the area below the line. A missing value
/// leaves a gap in the line and in the area.
pub fn sparkline(values: &[Option<f64>]) -> Vec<Item> {
    let step = 1.0 / values.len().saturating_sub(1).max(1) as f64;
    let point = |(index, value): (usize, &Option<f64>)| {
        value.map(|value| (index as f64 * step, 1.0 - value.clamp(0.0, 1.0)))
    };
    let points: Vec<_> = values.iter().enumerate().map(point).collect();
    let paths = [(Path::area(points.iter().copied()), "a"), (Path::line(points), "line")];
    paths.into_iter().map(|(path, class)| Item::path(path, Style::of_page(class))).collect()
}
