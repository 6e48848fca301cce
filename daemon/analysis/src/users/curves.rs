//! Latency against the number of edges.

use super::{Users, UsersLine};

/// Configuration with different numbers of edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve<'a> {
    /// Name that distinguishes the curve from the others, such as `s, cuda:0`; empty if there is only one.
    pub name: String,
    /// Points of the curve, the fewest edges first.
    pub points: Vec<&'a UsersLine>,
}

impl<'a> Curve<'a> {
    /// Returns the lines as curves. Lines that differ only in their number of edges form one curve. The axis that holds that number is
    /// found by its labels, which contain it; if no axis does, every label is a curve.
    pub fn from_users(users: &'a Users) -> Vec<Self> {
        let Users { axes: names, lines } = users;
        let counted = axis_of_edges(users);
        let varied = |axis: &usize| {
            Some(*axis) != counted
                && lines.iter().any(|line| line.labels.get(*axis) != lines[0].labels.get(*axis))
        };
        let axes: Vec<usize> = (0..names.len()).filter(varied).collect();
        let mut curves: Vec<Self> = Vec::new();
        for line in lines {
            let labels = axes.iter().filter_map(|axis| line.labels.get(*axis)).map(String::as_str);
            let name = labels.collect::<Vec<_>>().join(", ");
            match curves.iter_mut().find(|curve| curve.name == name) {
                Some(curve) => curve.points.push(line),
                None => curves.push(Self { name, points: vec![line] }),
            }
        }
        curves.iter_mut().for_each(|curve| curve.points.sort_by_key(|line| line.edges));
        curves
    }
}

/// Returns the axis whose labels are the numbers of edges, such as `4` or `4 robots`.
fn axis_of_edges(users: &Users) -> Option<usize> {
    let of_all = |axis: usize, names: &dyn Fn(&str, usize) -> bool| {
        users.lines.iter().all(|line| line.labels.get(axis).is_some_and(|label| names(label, line.edges)))
    };
    let varied = users.lines.windows(2).any(|pair| pair[0].edges != pair[1].edges);
    let alone = |label: &str, edges: usize| label.parse() == Ok(edges);
    let among = |label: &str, edges: usize| {
        label.split(|char: char| !char.is_ascii_digit()).any(|number| number.parse() == Ok(edges))
    };
    let axes = || (0..users.axes.len()).filter(|_| varied);
    axes().find(|axis| of_all(*axis, &alone)).or_else(|| axes().find(|axis| of_all(*axis, &among)))
}
