//! How the stages look: the dashboard's colours and a hatch each, so that they differ in grey as well.

use plotters::style::{RGBColor, WHITE};

use super::kit::{DOWNLOAD, Fill, Hatch, UPLOAD};

/// What `total` holds beyond its stages.
pub const UNATTRIBUTED: &str = "unattributed";

/// How a stage looks; one of a user's own looks like what nobody knows.
pub fn stage_fill(name: &str) -> Fill {
    let rgb = |hex: u32| RGBColor((hex >> 16) as u8, (hex >> 8) as u8, hex as u8);
    match name {
        "sensing" => Fill::dark(rgb(0x10_9e6d), Hatch::Plain),
        "encode" => Fill::pale(rgb(0x9a_cbab), rgb(0x4f_8f68), Hatch::Level),
        "send-queue" => Fill::pale(rgb(0xdd_c336), rgb(0x8c_7600), Hatch::Falling),
        "upload" => Fill::dark(UPLOAD, Hatch::Rising),
        "queue" => Fill::pale(rgb(0xdd_c336), rgb(0x8c_7600), Hatch::Rising),
        "ipc" => Fill::pale(rgb(0xf3_ecd0), rgb(0x8c_7600), Hatch::Cross),
        "preprocessing" => Fill::pale(rgb(0x56_bfec), rgb(0x1a_86b5), Hatch::Upright),
        "inference" => Fill::dark(rgb(0x0b_4796), Hatch::Plain),
        "postprocessing" => Fill::dark(rgb(0x73_77cc), Hatch::Cross),
        "download" => Fill::dark(DOWNLOAD, Hatch::Falling),
        "actuation" => Fill::dark(rgb(0x0c_5232), Hatch::Level),
        // A part of what is unattributed.
        "lateness" => Fill::pale(rgb(0xa9_b0ba), rgb(0x4a_525c), Hatch::Cross),
        _ => Fill::pale(rgb(0xc4_c9d0), rgb(0x72_7b87), Hatch::Plain),
    }
}

/// The colour of a stage's line: it holds on white, where the ground of a pale area would be lost.
pub fn stage_line(name: &str) -> RGBColor {
    let fill = stage_fill(name);
    match name {
        // Their areas differ in ground and hatch.
        "send-queue" => RGBColor(0xa0, 0x86, 0x00),
        "ipc" => RGBColor(0x5c, 0x4c, 0x00),
        _ if fill.line == WHITE => fill.colour,
        _ => fill.line,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use peernet_logger::stage;

    use super::*;

    /// Contrast with white (WCAG 2.1, relative luminance).
    fn contrast(colour: RGBColor) -> f64 {
        let linear = |part: u8| {
            let share = f64::from(part) / 255.0;
            if share <= 0.04045 { share / 12.92 } else { ((share + 0.055) / 1.055).powf(2.4) }
        };
        1.05 / (0.2126 * linear(colour.0) + 0.7152 * linear(colour.1) + 0.0722 * linear(colour.2) + 0.05)
    }

    #[test]
    fn every_line_holds_on_white() {
        let order = stage::ORDER;
        let names: Vec<&str> = order.iter().map(|name| &**name).chain(["a stage of one's own"]).collect();
        for name in &names {
            let line = stage_line(name);
            assert!(contrast(line) >= 3.0, "{name}: {line:?} {}", contrast(line));
        }
        let colours: BTreeSet<[u8; 3]> =
            names.iter().map(|name| stage_line(name)).map(|line| [line.0, line.1, line.2]).collect();
        assert_eq!(colours.len(), names.len(), "no two alike");
    }
}
