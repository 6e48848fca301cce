//! Curves of latency against the number of edges.

use super::{Users, UsersLine};
use crate::compare::readable_names;

/// Curve of one configuration over the number of edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve<'a> {
    /// Name that distinguishes the curve from the others, such as `s, cuda:0`; empty if there is only one curve.
    pub name: String,
    /// Points of the curve, in ascending order of the number of edges.
    pub points: Vec<&'a UsersLine>,
}

impl<'a> Curve<'a> {
    /// Returns the curves of the lines. Lines that differ only in their number of edges form one curve. The axis whose
    /// labels contain the number of edges is not part of a curve's name. All other axes with different labels
    /// distinguish the curves.
    pub fn from_users(users: &'a Users) -> Vec<Self> {
        let Users { axes: names, lines } = users;
        let axis_of_edges = axis_of_edges(users);
        let distinguishes_curves = |axis: &usize| {
            Some(*axis) != axis_of_edges
                && lines.iter().any(|line| line.labels.get(*axis) != lines[0].labels.get(*axis))
        };
        let axes: Vec<usize> = (0..names.len()).filter(distinguishes_curves).collect();
        let names: Vec<String> = axes.iter().map(|axis| names[*axis].clone()).collect();
        let (mut keys, mut curves): (Vec<Vec<String>>, Vec<Self>) = (Vec::new(), Vec::new());
        for line in lines {
            let labels: Vec<String> =
                axes.iter().map(|axis| line.labels.get(*axis).cloned().unwrap_or_default()).collect();
            match keys.iter().position(|key| *key == labels) {
                Some(index) => curves[index].points.push(line),
                None => {
                    curves.push(Self { name: String::new(), points: vec![line] });
                    keys.push(labels);
                }
            }
        }
        let names = readable_names(&names, keys.iter().map(Vec::as_slice));
        for (curve, name) in curves.iter_mut().zip(names) {
            curve.name = name;
            curve.points.sort_by_key(|line| line.edges);
        }
        curves
    }

    /// Returns whether the curve has points for different numbers of edges. Only then is there a curve to draw.
    pub fn is_over_edges(&self) -> bool {
        self.points.windows(2).any(|pair| pair[0].edges != pair[1].edges)
    }
}

/// Returns the index of the axis whose labels are the numbers of edges, such as `4`, or contain them, such as `4
/// robots`. `None` if no axis has such labels, or if all lines have the same number of edges.
fn axis_of_edges(users: &Users) -> Option<usize> {
    let all_labels_match = |axis: usize, matches: &dyn Fn(&str, usize) -> bool| {
        users.lines.iter().all(|line| line.labels.get(axis).is_some_and(|label| matches(label, line.edges)))
    };
    let edges_vary = users.lines.windows(2).any(|pair| pair[0].edges != pair[1].edges);
    let is_number = |label: &str, edges: usize| label.parse() == Ok(edges);
    let contains_number = |label: &str, edges: usize| {
        label.split(|char: char| !char.is_ascii_digit()).any(|number| number.parse() == Ok(edges))
    };
    // If all lines have the same number of edges, no axis is returned.
    let axes = || (0..users.axes.len()).filter(|_| edges_vary);
    // An axis whose labels are the numbers themselves comes first: labels of another axis, such as the model `v2`, may
    // contain the same numbers by chance.
    let axis_of_numbers = axes().find(|axis| all_labels_match(*axis, &is_number));
    axis_of_numbers.or_else(|| axes().find(|axis| all_labels_match(*axis, &contains_number)))
}
