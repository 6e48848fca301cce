//! How the stages look: the dashboard's colours and a hatch each, so that they differ in grey as well.

use plotters::style::RGBColor;

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
        _ => Fill::pale(rgb(0xc4_c9d0), rgb(0x72_7b87), Hatch::Plain),
    }
}
