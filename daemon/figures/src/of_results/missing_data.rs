//! Data that a figure needs, but that the results lack.

use std::fmt;

use crate::drawing::{MAX_GROUPS, MAX_PLACEMENTS};
use peernet_analysis::accuracy::UnknownLabels;
use peernet_analysis::answer_length::NO_USAGE;
use peernet_analysis::quality::Quality;
use peernet_statistics::number::counted;

/// Data that a figure needs, but that the results lack.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MissingData {
    /// There are no runs.
    #[error("there is no run")]
    Runs,
    /// No iteration is in the statistics: each is warm-up or failed.
    #[error("no iteration after the warm-up succeeded")]
    Iterations,
    /// No successful iteration has a total that can be drawn.
    #[error("no successful iteration has a total that can be drawn")]
    Total,
    /// The column has no number that can be drawn.
    #[error("no successful iteration after the warm-up has a number that can be drawn in the column {0}")]
    Column(String),
    /// No iteration has a number that can be drawn in both columns.
    #[error(
        "no successful iteration after the warm-up has a number that can be drawn in both columns, {x} and {y}"
    )]
    Columns {
        /// The column of the horizontal axis.
        x: String,
        /// The column of the vertical axis.
        y: String,
    },
    /// The given name is the name of a node that has several columns.
    #[error("the name {name} stands for several columns: {}; name one of them", .columns.join(", "))]
    AmbiguousColumn {
        /// The given name.
        name: String,
        /// The columns of nodes with this name.
        columns: Vec<String>,
    },
    /// A language model's server reported no numbers of tokens (`usage`), and the column that would be used as length
    /// instead shows no differences.
    #[error("the lengths of the answers are not known{}: {NO_USAGE}", .substitute.as_ref().map_or_else(String::new, |column| format!(" ({column} does not show how they differ)")))]
    TokenCounts {
        /// The column that would be used as length instead; `None` if this column has no positive value.
        substitute: Option<String>,
    },
    /// The length is the same in every iteration.
    #[error(
        "all answers have the same length: {x} is {length} in every iteration; name another column with --x"
    )]
    SameLength {
        /// The column of lengths.
        x: String,
        /// The length of all answers.
        length: f64,
    },
    /// The lengths of the answers differ too little to show how latency depends on length.
    #[error("all answers have nearly the same length ({x}); name another column with --x")]
    SimilarLength {
        /// The column of lengths.
        x: String,
    },
    /// No model has numbers in the column at two placements.
    #[error(
        "it needs the column {column} of one model at two placements, such as a local and a remote run of the same \
         model"
    )]
    SecondPlacement {
        /// The column to be compared.
        column: String,
    },
    /// There are more models or placements than fit.
    #[error(
        "{models} models at {placements} placements are too many for one figure (at most {MAX_GROUPS} models and {MAX_PLACEMENTS} \
         placements); name fewer runs"
    )]
    TooManyModels {
        /// Number of models.
        models: usize,
        /// Number of placements at which they ran.
        placements: usize,
    },
    /// The largest message has less than twice the size of the smallest.
    #[error(
        "it needs messages of different sizes over one network, the largest at least twice the smallest; see \
         peernet calibrate and the experiment payload-study"
    )]
    MessageSizes,
    /// No answer was scored as right or wrong.
    #[error("it needs answers to labelled samples, and no successful iteration after the warm-up has a {}, {} or {}{}", Quality::Top1.name(), Quality::Map50.name(), Quality::MeanIou.name(), UnscoredIterations(.unknown))]
    Labels {
        /// Iterations with a label that the model does not know.
        unknown: Option<UnknownLabels>,
    },
    /// No run had several edges.
    #[error("it needs runs of an experiment with several edges at the same time: set experiment.users")]
    Users,
    /// No run has a time at which all of its edges measured. A figure against the number of edges
    /// shows only iterations from such a time.
    #[error(
        "the edges of each run measured at different times, so no iteration counts for `total`; run the \
         edges at the same time"
    )]
    CommonTotal,
}

/// End of the text of [`MissingData::Labels`]: the number of iterations that cannot have a score. The text is empty if
/// there are none.
struct UnscoredIterations<'a>(&'a Option<UnknownLabels>);

impl fmt::Display for UnscoredIterations<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.as_ref().map_or(Ok(()), |unknown_labels| {
            let iterations = counted(unknown_labels.count, "iteration");
            write!(f, "; {iterations} cannot have one, {}", unknown_labels.reason())
        })
    }
}
