//! The commands of the documents, each typed with the real programs: what uses a network, between two machines.

mod alone;
mod by_hand;
mod paper;
mod published;
mod two_machines;

use std::collections::BTreeSet;

use peernet_tests::{Document, root};

use crate::experiments::{same_seed, users};

/// What the tests here type, and the experiments'.
const TYPED: [&[&str]; 7] = [
    &alone::COMMANDS,
    &by_hand::COMMANDS,
    &paper::COMMANDS,
    &published::COMMANDS,
    &same_seed::COMMANDS,
    &two_machines::COMMANDS,
    &users::COMMANDS,
];

/// Commands that other tests run, and these: with fewer iterations, and with random weights, which nobody has to download.
const ELSEWHERE: [(&str, &str); 5] = [
    (
        "PEERNet --server --name cluster --network zmq-tcp --network-config net_config.yaml --model-name efficientnet_v2_s --device cuda:6 --iterations 10005",
        "published/commands.rs: the_published_commands_work_word_for_word",
    ),
    (
        "PEERNet --client --name jetson-orin --network zmq-tcp --network-config net_config.yaml --dataset-loc sample-image.JPEG --iterations 10005 --result-loc results --generate-plots",
        "published/commands.rs: the_published_commands_work_word_for_word",
    ),
    (
        "python3 models/export_torchvision.py efficientnet_v2_s efficientnet_v2_m efficientnet_v2_l",
        "models/torchvision.rs: an_exported_model_answers_as_torchvision_does",
    ),
    (
        "/usr/bin/python3 models/export_torchvision.py efficientnet_v2_s efficientnet_v2_m efficientnet_v2_l",
        "models/torchvision.rs: an_exported_model_answers_as_torchvision_does",
    ),
    (
        "/usr/bin/python3 models/export_torchvision.py resnet50 --weights IMAGENET1K_V1 --models-dir /var/lib/peernet/models",
        "models/torchvision.rs: an_exported_model_answers_as_torchvision_does",
    ),
];

#[test]
fn every_command_of_the_documents_is_typed_by_a_test() {
    let shown: BTreeSet<String> =
        Document::for_users().iter().flat_map(|document| document.commands()).collect();
    let elsewhere = ELSEWHERE.iter().map(|(command, _)| *command);
    let run: BTreeSet<String> = TYPED.concat().into_iter().chain(elsewhere).map(str::to_owned).collect();
    let nowhere: Vec<_> = shown.difference(&run).collect();
    assert!(nowhere.is_empty(), "no test types these commands of the documents: {nowhere:#?}");
    let gone: Vec<_> = run.difference(&shown).collect();
    assert!(gone.is_empty(), "no document shows these commands that tests type: {gone:#?}");

    for (command, test) in ELSEWHERE {
        let (file, name) = test.split_once(": ").expect("a file and a function");
        let text = std::fs::read_to_string(root().join("tests/tests/it").join(file));
        let found = text.is_ok_and(|text| text.contains(&format!("#[test]\nfn {name}()")));
        assert!(found, "there is no test {test}, which is to run {command}");
    }
}
