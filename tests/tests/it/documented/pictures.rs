//! Generation of the demo model's pictures and training with them, with fewer pictures.

use peernet_tests::{DocumentedCommands, ProcessEnd};

pub(crate) const COMMANDS: [&str; 5] = [PICTURES, HELD_OUT, THIRD, TRAIN, TRAIN_DETECTOR];

const PICTURES: &str = "/usr/bin/python3 models/quality_control/draw.py models/quality-control/pictures --width 1280 --quality 85 --first-seed 3000001 --count good=18 scratched=4 dented=4 \"hole missing=4\"";
const HELD_OUT: &str = "/usr/bin/python3 models/quality_control/draw.py models/quality-control/held-out --width 640 --quality 80 --first-seed 4000001 --count good=25 scratched=25 dented=25 \"hole missing=25\"";
const THIRD: &str = "/usr/bin/python3 models/quality_control/draw.py /tmp/third --width 1280 --quality 85 --first-seed 6000001 --count good=100 scratched=100 dented=100 \"hole missing=100\"";
const TRAIN: &str = "/usr/bin/python3 models/quality_control/train.py models/quality-control";
const TRAIN_DETECTOR: &str =
    "/usr/bin/python3 models/quality_control/detector.py models/quality-control models/defect-detector";

fn assert_success(end: ProcessEnd) -> String {
    assert_eq!(end.code(), 0, "{}", end.log);
    end.log
}

#[test]
fn redrawn_pictures_are_classified_and_network_is_trained() {
    let machines = DocumentedCommands::new(&COMMANDS);
    for (command, folder, [good, others]) in [
        (PICTURES, "models/quality-control/pictures", ["=18", "=4"]),
        (HELD_OUT, "models/quality-control/held-out", ["=25", "=25"]),
        (THIRD, "/tmp/third", ["=100", "=100"]),
    ] {
        assert_success(
            machines.on_edge(command, &[(folder, "drawn"), (good, "=1"), (others, "=1")]).wait_for_end(),
        );
        // The model was trained with thousands of such pictures.
        let check = "peernet models check quality-control --pictures drawn";
        let output = assert_success(machines.run_on(machines.edge(), check).wait_for_end());
        assert!(output.contains("4 of 4 labels right"), "{command}: {output}");
    }
    let options = "trained --scenes 16 --validation-scenes 4 --epochs 6";
    assert_success(machines.on_edge(TRAIN, &[("models/quality-control", options)]).wait_for_end());
    let check =
        assert_success(machines.run_on(machines.edge(), "peernet models check ./trained").wait_for_end());
    assert!(check.contains("run on zeros"), "{check}");
    let options = "detector --scenes 8 --epochs 2 --pictures 3";
    assert_success(machines.on_edge(TRAIN_DETECTOR, &[("models/defect-detector", options)]).wait_for_end());
    let check =
        assert_success(machines.run_on(machines.edge(), "peernet models check ./detector").wait_for_end());
    assert!(check.contains("answered 3 pictures") && check.contains("mAP@0.5"), "{check}");
    machines.finish();
}
