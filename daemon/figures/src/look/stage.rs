//! Stages: one table of names, classes, colours and hatches for every figure and page.

use peernet_analysis::rows::LATENESS;
use peernet_analysis::slowness::{BOTH_DIRECTIONS, REST_OF_UNATTRIBUTED};
use peernet_analysis::unaccounted_time::NETWORK_AND_REST;

use super::colour::{INK, INK_3, LINE_STRONG, ON_DARK, ON_PALE, Rgb, Token, WHITE};
use super::hatch::Hatch;
use super::style::{Fill, Style, TextStyle};

/// Name of the part of `total` that belongs to no stage.
const UNATTRIBUTED: &str = "unattributed";
/// Class of the sum of upload and download. The sum is shown if the clocks cannot separate the two.
const NETWORK: &str = "network";
/// Class of totals. A total is the sum of all stages.
const TOTAL: &str = "total";

/// Look of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stage {
    /// Name in results and events.
    pub name: &'static str,
    /// Suffix of the classes `f-…` (fill) and `o-…` (text on the fill) on pages. Stages of one class share a colour.
    pub class: &'static str,
    /// Colour of the fill.
    pub colour: Token,
    /// Darker edge of a fill that is pale on paper, so that every boundary has a contrast of at least 3.
    pub edge: Option<Token>,
    /// Hatch in a file, so that stages differ without colour, too. On pages, only stages of waiting and the
    /// unattributed time have a hatch.
    pub hatch: Hatch,
    /// Colour of a line in a file, for totals and for stages whose fill and edge have the colours of another stage;
    /// `None` if lines have the colour of the edge or, without an edge, of the fill.
    line: Option<Rgb>,
}

const QUEUE_FILL: Token = Token::new("s-queue", 0xdd_c336, 0xf0_e442);
const QUEUE_EDGE: Token = Token::new("e-queue", 0x8c_7600, 0xf0_e442);
const ENCODE_FILL: Token = Token::new("s-encode", 0x9a_cbab, 0xbe_e1c9);
const ENCODE_EDGE: Token = Token::new("e-encode", 0x4f_8f68, 0xbe_e1c9);
const UNATTRIBUTED_FILL: Token = Token::new("s-unattributed", 0xa0_a7b0, 0x62_6974);
const UNATTRIBUTED_EDGE: Token = Token::new("e-unattributed", 0x72_7b87, 0x8e_98a6);

/// Returns a stage whose fill is dark enough to need no edge.
const fn dark(name: &'static str, colour: Token, hatch: Hatch) -> Stage {
    Stage { name, class: name, colour, edge: None, hatch, line: None }
}

/// Returns a stage with a pale fill and a darker edge.
const fn pale(name: &'static str, class: &'static str, colour: Token, edge: Token, hatch: Hatch) -> Stage {
    Stage { name, class, colour, edge: Some(edge), hatch, line: None }
}

/// Every stage in the order of stacks, keys and tables; the unattributed time is the last.
pub const STAGES: [Stage; 14] = [
    dark("sensing", Token::new("s-sensing", 0x10_9e6d, 0x29_b783), Hatch::Plain),
    pale("encode", "encode", ENCODE_FILL, ENCODE_EDGE, Hatch::Horizontal),
    Stage {
        line: Some(Rgb::hex(0xa0_8600)),
        ..pale("send-queue", "queue", QUEUE_FILL, QUEUE_EDGE, Hatch::Falling)
    },
    dark("upload", Token::new("s-upload", 0xd5_5e00, 0xee_6c16), Hatch::Rising),
    pale("queue", "queue", QUEUE_FILL, QUEUE_EDGE, Hatch::Rising),
    Stage {
        line: Some(Rgb::hex(0x6b_5a00)),
        ..pale("batch-wait", "queue", QUEUE_FILL, QUEUE_EDGE, Hatch::Horizontal)
    },
    // Handing a sample to a model in a separate process is similar to encoding the sample for the network, so both
    // stages have similar colours.
    Stage {
        line: Some(Rgb::hex(0x2f_6b48)),
        ..pale("ipc", "encode", ENCODE_FILL, ENCODE_EDGE, Hatch::Cross)
    },
    pale(
        "preprocessing",
        "preprocessing",
        Token::new("s-preprocessing", 0x56_bfec, 0x9a_dcf8),
        Token::new("e-preprocessing", 0x1a_86b5, 0x9a_dcf8),
        Hatch::Vertical,
    ),
    dark("inference", Token::new("s-inference", 0x0b_4796, 0x3b_7ddb), Hatch::Plain),
    dark("postprocessing", Token::new("s-postprocessing", 0x73_77cc, 0xa3_a6f2), Hatch::Cross),
    dark("download", Token::new("s-download", 0xae_5485, 0xcc_749f), Hatch::Falling),
    dark("actuation", Token::new("s-actuation", 0x0c_5232, 0x38_785a), Hatch::Horizontal),
    Stage {
        line: Some(Rgb::hex(0x4a_525c)),
        ..pale(LATENESS, UNATTRIBUTED, UNATTRIBUTED_FILL, UNATTRIBUTED_EDGE, Hatch::Cross)
    },
    pale(UNATTRIBUTED, UNATTRIBUTED, UNATTRIBUTED_FILL, UNATTRIBUTED_EDGE, Hatch::Falling),
];

/// Looks of quantities that are not stages: parts of stages, both directions together, totals. Each look has the name
/// that events use for the quantity.
const NON_STAGES: [Stage; 7] = [
    // In `STAGES`, 0 is the index of `sensing`, 3 of `upload` and 13 of the unattributed time.
    Stage { name: "capture", class: "capture", ..STAGES[0] },
    Stage { name: "transform", class: "transform", ..STAGES[0] },
    Stage { name: BOTH_DIRECTIONS, class: NETWORK, ..STAGES[3] },
    Stage { name: NETWORK_AND_REST, class: NETWORK, ..STAGES[3] },
    Stage { name: REST_OF_UNATTRIBUTED, ..STAGES[13] },
    Stage { line: Some(INK.light), ..dark(TOTAL, LINE_STRONG, Hatch::Plain) },
    Stage { class: TOTAL, line: Some(INK.light), ..dark("stages-total", LINE_STRONG, Hatch::Plain) },
];

/// Look of every stage that custom code defines.
const CUSTOM_STAGE: Stage =
    Stage { name: "", class: "other", colour: INK_3, edge: None, hatch: Hatch::Plain, line: None };

/// Returns the label of a stage, or of a part of a stage, in legends, tables and sentences. The label is the name,
/// except for [`LATENESS`].
pub fn label(name: &str) -> &str {
    if name == LATENESS { "late start" } else { name }
}

/// Returns the look of the stage, part of a stage or total with this name. A stage with any other name is defined by
/// custom code and has the colour of quiet text.
pub fn stage(name: &str) -> Stage {
    STAGES.iter().chain(&NON_STAGES).copied().find(|stage| stage.name == name).unwrap_or(CUSTOM_STAGE)
}

impl Stage {
    /// Returns whether the stage is one of [`STAGES`]. Only these stages have a colour of their own.
    pub fn has_colour(&self) -> bool {
        STAGES.iter().any(|stage| stage.name == self.name)
    }

    /// Returns the style of text on the stage's area.
    pub fn text(&self) -> TextStyle {
        let (class, colour) = match self.class {
            "sensing" => ("o-sensing", ON_PALE),
            "capture" => ("o-capture", ON_PALE),
            "transform" => ("o-transform", ON_PALE),
            "encode" => ("o-encode", ON_PALE),
            "queue" => ("o-queue", ON_PALE),
            "upload" => ("o-upload", ON_PALE),
            NETWORK => ("o-network", ON_PALE),
            "preprocessing" => ("o-preprocessing", ON_PALE),
            "inference" => ("o-inference", ON_DARK),
            "postprocessing" => ("o-postprocessing", ON_PALE),
            "download" => ("o-download", ON_DARK),
            "actuation" => ("o-actuation", ON_DARK),
            UNATTRIBUTED => ("o-unattributed", ON_PALE),
            _ => ("o-other", ON_DARK),
        };
        TextStyle { class, colour, has_halo: false }
    }

    /// Returns the style of the stage's area in a stack.
    pub fn area(&self) -> Style {
        // White lines would not be visible on a pale fill.
        let hatch = match self.edge {
            Some(edge) => (self.hatch, edge.light),
            None => (self.hatch, WHITE),
        };
        let area =
            Style::area(class("f-", self.class), Fill { hatch: Some(hatch), ..Fill::of(self.colour.light) });
        match self.edge {
            Some(edge) => area.with("edge").edged(Some(edge.light)),
            None => area,
        }
    }

    /// Returns the style of the stage's area without a hatch, for bars that are side by side. A hatch would blur such
    /// bars.
    pub fn plain(&self) -> Style {
        Style::area(class("f-", self.class), Fill::of(self.colour.light))
    }

    /// Returns the colour of the stage's line or marks in a file. It can differ from the colour of the fill, because a
    /// pale colour would not have enough contrast to white paper.
    pub fn line_colour(&self) -> Rgb {
        self.line.unwrap_or_else(|| self.edge.unwrap_or(self.colour).light)
    }

    /// Returns the style of the stage's line.
    pub fn line(&self, width: f64) -> Style {
        Style::line(class("g-", self.class), self.line_colour(), width)
    }

    /// Returns the style of the stage's points and marks.
    pub fn mark(&self) -> Style {
        Style::area(class("f-", self.class), Fill::of(self.line_colour()))
    }
}

fn class(prefix: &str, class: &str) -> String {
    format!("{prefix}{class}")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::super::colour::TOKENS;
    use super::*;

    #[test]
    fn stages_have_the_order_of_the_logger() {
        use peernet_logger::{Name, stage};
        let order = stage::ORDER.into_iter().chain([stage::LATENESS, stage::UNATTRIBUTED]);
        let names: Vec<&str> = STAGES.iter().map(|stage| stage.name).collect();
        assert_eq!(order.collect::<Vec<Name>>(), names);
    }

    #[test]
    fn stage_colours_have_contrast_and_differ() {
        let lines: BTreeSet<Rgb> = STAGES.iter().chain([&CUSTOM_STAGE]).map(Stage::line_colour).collect();
        assert_eq!(lines.len(), STAGES.len() + 1);
        for stage in STAGES {
            let line = stage.line_colour();
            assert!(
                line.contrast(WHITE) >= 3.0,
                "{}: {line} has the contrast {}",
                stage.name,
                line.contrast(WHITE)
            );
        }
    }

    #[test]
    fn dashboard_has_colours_of_figures() {
        let sheet = include_str!("../../../../web/assets/css/tokens.css");
        let stage_tokens = STAGES.iter().flat_map(|stage| std::iter::once(stage.colour).chain(stage.edge));
        for Token { name, light, dark } in stage_tokens.chain(TOKENS) {
            let rule = format!("--{name}: light-dark({light}, {dark});");
            assert!(sheet.contains(&rule), "no rule: {rule}");
        }
    }

    #[test]
    fn custom_stage_has_no_colour_of_its_own() {
        assert_eq!((stage("\"><script>").class, stage("upload").class), ("other", "upload"));
        let names = ["capture", BOTH_DIRECTIONS, REST_OF_UNATTRIBUTED, "total", "stages-total"];
        let classes = names.map(|name| stage(name).class);
        assert_eq!(classes, ["capture", "network", "unattributed", "total", "total"]);
        let has_colour =
            ["lateness", "upload", "total", "a custom stage"].map(|name| stage(name).has_colour());
        assert_eq!(has_colour, [true, true, false, false]);
    }

    #[test]
    fn text_has_contrast_on_its_stage() {
        for stage in STAGES {
            let contrast = stage.text().colour.contrast(stage.colour.light);
            assert!(contrast >= 4.5, "the text on {} has the contrast {contrast}", stage.name);
            let rule = format!(".{}", stage.text().class);
            assert!(
                include_str!("../../../../web/assets/css/pictures.css").contains(&rule)
                    || include_str!("../../../../web/assets/css/tokens.css").contains(&rule),
                "no rule: {rule}"
            );
        }
    }
}
