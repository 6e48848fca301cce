//! Lines and areas of many points.

/// Step of a path to a point. The point is given as a share of the plot's width from the left and a share of the plot's
/// height from the top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Moves to the point without drawing.
    Move(f64, f64),
    /// Draws a line to the point.
    Line(f64, f64),
    /// Draws a line back to the point of the most recent [`Step::Move`].
    Close,
}

/// Line or outline that consists of straight pieces.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path {
    /// Steps of the path.
    pub steps: Vec<Step>,
    /// Distance by which a file moves the whole path to the right, points. Pages ignore this distance.
    pub dx: f64,
}

/// Point of a path: shares from the left and from the top.
type Point = (f64, f64);

impl Path {
    /// Returns whether there is nothing to draw.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Returns the points that the path moves or draws to.
    pub fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.steps.iter().filter_map(|step| match step {
            Step::Move(x, y) | Step::Line(x, y) => Some((*x, *y)),
            Step::Close => None,
        })
    }

    /// Returns the same path, which a file moves to the right by `dx` points.
    #[must_use]
    pub fn offset_by(self, dx: f64) -> Self {
        Self { dx, ..self }
    }

    /// Returns the same path without the points that would lie outside of the plot if the path were moved to the right
    /// by this share of the plot's width.
    #[must_use]
    pub fn within(mut self, share: f64) -> Self {
        let inside = |x: f64| (0.0..=1.0).contains(&(x + share));
        self.steps.retain(|step| match step {
            Step::Move(x, _) | Step::Line(x, _) => inside(*x),
            Step::Close => true,
        });
        // A path must begin with a move.
        if let Some(Step::Line(x, y)) = self.steps.first().copied() {
            self.steps[0] = Step::Move(x, y);
        }
        self
    }

    fn from_steps(steps: Vec<Step>) -> Self {
        Self { steps, dx: 0.0 }
    }

    /// Returns a line through these points. A missing point (`None`) interrupts the line. A point between two missing
    /// points becomes a dot.
    pub fn line(points: impl IntoIterator<Item = Option<Point>>) -> Self {
        let (mut steps, mut in_piece, mut lone_point) = (Vec::new(), false, None);
        // The missing point at the end finishes the last piece.
        for point in points.into_iter().chain([None]) {
            match point {
                Some((x, y)) => {
                    steps.push(if in_piece { Step::Line(x, y) } else { Step::Move(x, y) });
                    lone_point = (!in_piece).then_some((x, y));
                    in_piece = true;
                }
                None => {
                    // A line of length zero is visible as a dot, because strokes have round ends.
                    steps.extend(lone_point.take().map(|(x, y)| Step::Line(x, y)));
                    in_piece = false;
                }
            }
        }
        Self::from_steps(steps)
    }

    /// Returns the area between two lines. A missing point (`None`) interrupts the area. A point has three shares of
    /// the plot: its position from the left, the position of the upper line from the top, and the position of the lower
    /// line from the top.
    pub fn band(points: impl IntoIterator<Item = Option<(f64, f64, f64)>>) -> Self {
        let mut steps = Vec::new();
        let mut piece: Vec<(f64, f64, f64)> = Vec::new();
        for point in points.into_iter().chain([None]) {
            match point {
                Some(point) => piece.push(point),
                None => {
                    let upper = piece.iter().map(|(x, upper, _)| (*x, *upper));
                    let lower = piece.iter().rev().map(|(x, _, lower)| (*x, *lower));
                    append_outline(&mut steps, upper.chain(lower));
                    piece.clear();
                }
            }
        }
        Self::from_steps(steps)
    }

    /// Returns the area between a line and the lower end of the plot. A missing point interrupts the area.
    pub fn area(points: impl IntoIterator<Item = Option<Point>>) -> Self {
        Self::band(points.into_iter().map(|point| point.map(|(x, y)| (x, y, 1.0))))
    }

    /// Returns an area with these corners.
    pub fn polygon(points: impl IntoIterator<Item = Point>) -> Self {
        let mut steps = Vec::new();
        append_outline(&mut steps, points);
        Self::from_steps(steps)
    }

    /// Returns rectangles, each between its left upper and its right lower corner.
    pub fn rects(corners: impl IntoIterator<Item = [Point; 2]>) -> Self {
        let mut steps = Vec::new();
        for [(left, top), (right, bottom)] in corners {
            append_outline(&mut steps, [(left, top), (right, top), (right, bottom), (left, bottom)]);
        }
        Self::from_steps(steps)
    }

    /// Returns dots: lines of length zero, which a stroke with round ends makes visible.
    pub fn dots(points: impl IntoIterator<Item = Point>) -> Self {
        Self::from_steps(points.into_iter().flat_map(|(x, y)| [Step::Move(x, y), Step::Line(x, y)]).collect())
    }

    /// Returns upright strokes. Each stroke is given by its position from the left, its upper end and its lower end, as
    /// shares of the plot.
    pub fn ticks(ticks: impl IntoIterator<Item = (f64, f64, f64)>) -> Self {
        let steps =
            ticks.into_iter().flat_map(|(x, upper, lower)| [Step::Move(x, upper), Step::Line(x, lower)]);
        Self::from_steps(steps.collect())
    }

    /// Returns upright error bars. Each error bar is given by its position from the left, its upper end and its lower
    /// end, as shares of the plot. The caps extend to each side by the share `cap` of the plot's width.
    pub fn whiskers(points: impl IntoIterator<Item = (f64, f64, f64)>, cap: f64) -> Self {
        let steps = points.into_iter().flat_map(|(x, upper, lower)| {
            let stroke = |from: Point, to: Point| [Step::Move(from.0, from.1), Step::Line(to.0, to.1)];
            let cap_at = |y: f64| stroke((x - cap, y), (x + cap, y));
            [stroke((x, upper), (x, lower)), cap_at(upper), cap_at(lower)].concat()
        });
        Self::from_steps(steps.collect())
    }
}

/// Appends the steps of a closed outline.
fn append_outline(steps: &mut Vec<Step>, points: impl IntoIterator<Item = Point>) {
    let first_step = steps.len();
    for (x, y) in points {
        steps.push(if steps.len() == first_step { Step::Move(x, y) } else { Step::Line(x, y) });
    }
    if steps.len() > first_step {
        steps.push(Step::Close);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_point_interrupts_lines_and_areas() {
        let points = [Some((0.0, 0.0)), Some((0.1, 1.0)), None, Some((0.5, 0.5))];
        let line = Path::line(points).steps;
        let expected =
            [Step::Move(0.0, 0.0), Step::Line(0.1, 1.0), Step::Move(0.5, 0.5), Step::Line(0.5, 0.5)];
        assert_eq!(line, expected);
        let band =
            Path::band([Some((0.0, 0.1, 0.2)), Some((0.1, 0.1, 0.2)), None, Some((0.5, 0.1, 0.2))]).steps;
        assert_eq!(band.iter().filter(|step| **step == Step::Close).count(), 2);
        assert_eq!(band[..3], [Step::Move(0.0, 0.1), Step::Line(0.1, 0.1), Step::Line(0.1, 0.2)]);
        assert!(Path::line([None, None]).is_empty() && Path::band([None]).is_empty());
        let area = Path::area([Some((0.0, 0.2)), Some((0.1, 0.3)), None, Some((0.5, 0.1))]).steps;
        assert!(area.contains(&Step::Line(0.1, 1.0)) && area.contains(&Step::Line(0.5, 1.0)), "{area:?}");
    }

    #[test]
    fn whisker_has_caps_and_dot_has_zero_length() {
        let whisker = Path::whiskers([(0.5, 0.2, 0.4)], 0.01).steps;
        assert_eq!(whisker.iter().filter(|step| matches!(step, Step::Move(..))).count(), 3);
        assert_eq!(Path::dots([(0.5, 0.5)]).steps, [Step::Move(0.5, 0.5), Step::Line(0.5, 0.5)]);
    }
}
