//! Figure of two quantities of each iteration against each other, such as the length of answers and latency, with the
//! distributions of both quantities at the sides.

use peernet_statistics::Summary;
use peernet_statistics::number::fixed;

use super::binned::BinnedAxis;
use super::joint::Joint;
use crate::look::stage;
use crate::plot::{Figure, Plot, Unit};

/// Points of single iterations with the distributions of both quantities, drawn as a [`Joint`] plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Lengths {
    /// Title of the figure.
    pub title: String,
    /// Unit of the horizontal axis.
    pub x: Unit,
    /// Unit of the vertical axis.
    pub y: Unit,
    /// Stage whose quantity the vertical axis shows. It determines the colour of the points.
    pub stage: String,
    /// One point for each iteration, SI units. Points that are not finite are not drawn.
    pub points: Vec<(f64, f64)>,
    /// Intercept and slope of the line through the points, in SI units; `None` if no line is drawn.
    pub line: Option<(f64, f64)>,
    /// Notes below the figure, such as the number of points and what is left out.
    pub notes: Vec<String>,
}

impl Lengths {
    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let (title, notes) = (self.title.clone(), self.notes.clone());
        Figure { title, notes, plots: self.plot().into_iter().collect(), ..Figure::default() }
    }

    fn plot(&self) -> Option<Plot> {
        let finite: Vec<_> =
            self.points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
        let (mut xs, mut ys) = (Summary::default(), Summary::default());
        for (x, y) in &finite {
            xs.record(*x);
            ys.record(*y);
        }
        let x_axis = BinnedAxis::from_zero(std::iter::once(&xs), self.x.clone())?;
        let y_axis = BinnedAxis::from_zero(std::iter::once(&ys), self.y.clone())?;
        let joint = Joint {
            stage: stage(&self.stage),
            points: &finite,
            x: (&x_axis, &xs),
            y: (&y_axis, &ys),
            line: self.line,
        };
        let mut plot = joint.plot();
        let beyond = self.points.len() - joint.positions().len();
        plot.remark = (beyond > 0).then(|| format!("{} beyond the axes", fixed(beyond as f64, 0)));
        Some(plot)
    }
}
