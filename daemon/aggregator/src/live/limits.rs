//! Limits on what an agent sends. Texts and lists are cut before the live state keeps them, so that the memory of the
//! live state is bounded whatever an agent sends.
//!
//! `discarded_items` counts the items that are not kept. Cut texts are not counted.

use peernet_stream::{
    Accounting, Connection, HostClock, HostDescription, LinkLive, NetworkInterface, PipelineState, Placement,
    Probing, ReflectorLive,
};

use peernet_store::plausible;

/// Maximum length of a list, except the list of models: network names, pipelines and connections of a link,
/// accelerators, steps of an injected clock fault.
const MAX_LIST_ITEMS: usize = 32;
/// Maximum number of models of a host.
const MAX_MODELS: usize = 256;
/// Maximum length of a text, bytes.
const MAX_TEXT_BYTES: usize = 512;

/// Cuts a link's state and removes impossible clock values. Adds to `discarded_items` each list item that is removed,
/// 1 if any value of the clock relation is removed, and 1 if the offset of the reflector is removed.
pub(super) fn limit_link(live: &mut LinkLive, discarded_items: &mut u64) {
    limit_list(&mut live.networks, MAX_LIST_ITEMS, discarded_items);
    live.networks.iter_mut().for_each(limit_text);
    limit_list(&mut live.pipelines, MAX_LIST_ITEMS, discarded_items);
    limit_probing(&mut live.probing);
    if let Some(reflector) = &mut live.reflector {
        limit_reflector(reflector, discarded_items);
    }
    limit_list(&mut live.connections, MAX_LIST_ITEMS, discarded_items);
    live.connections.iter_mut().for_each(limit_connection);
    for host_clock in [&mut live.edge, &mut live.cloud].into_iter().flatten() {
        limit_clock(host_clock, discarded_items);
    }
    let sample = &mut live.latest_sample;
    let offset = sample.offset.as_ref().and_then(plausible::offset);
    let (up, down) = (sample.up.map(plausible::delays), sample.down.map(plausible::delays));
    let basis = sample.basis.map(plausible::basis);
    // NaN is unequal to itself, so the comparison also counts a removed NaN.
    *discarded_items +=
        u64::from((&offset, up, down, basis) != (&sample.offset, sample.up, sample.down, sample.basis));
    (sample.offset, sample.up, sample.down, sample.basis) = (offset, up, down, basis);
}

/// Cuts the state of probing.
fn limit_probing(probing: &mut Probing) {
    match probing {
        Probing::On { address, stamps, .. } => [address, stamps].into_iter().for_each(limit_text),
        Probing::Unanswered { address, reason } => [address].into_iter().chain(reason).for_each(limit_text),
        Probing::Off(reason) => limit_text(reason),
    }
}

/// Cuts the state of a link's reflector.
fn limit_reflector(reflector: &mut ReflectorLive, discarded_items: &mut u64) {
    limit_text(&mut reflector.address);
    limit_probing(&mut reflector.probing);
    let offset = reflector.offset.as_ref().and_then(plausible::offset);
    *discarded_items += u64::from(offset != reflector.offset);
    reflector.offset = offset;
}

/// Cuts a connection of a link.
fn limit_connection(connection: &mut Connection) {
    let Connection { local, remote, interface, .. } = connection;
    [local, remote].into_iter().flatten().for_each(limit_text);
    if let Some(NetworkInterface { name, kind, .. }) = interface {
        limit_text(name);
        kind.iter_mut().for_each(limit_text);
    }
}

/// Cuts a host's clock state.
pub(super) fn limit_clock(clock: &mut HostClock, discarded_items: &mut u64) {
    limit_text(&mut clock.text);
    clock.clocksource.iter_mut().for_each(limit_text);
    if let Some(faults) = &mut clock.faults {
        limit_list(&mut faults.steps, MAX_LIST_ITEMS, discarded_items);
    }
}

/// Cuts a host's description.
pub(crate) fn limit_description(description: &mut HostDescription, discarded_items: &mut u64) {
    let hardware = &mut description.hardware;
    limit_list(&mut hardware.gpus, MAX_LIST_ITEMS, discarded_items);
    limit_list(&mut description.models, MAX_MODELS, discarded_items);
    let texts =
        [&mut description.version, &mut hardware.cpu, &mut hardware.system, &mut hardware.architecture];
    texts.into_iter().chain(&mut hardware.gpus).chain(&mut description.serves).for_each(limit_text);
}

/// Cuts a host's accounting of events.
pub(super) fn limit_accounting(accounting: &mut Accounting) {
    accounting.trouble.iter_mut().for_each(limit_text);
}

/// Cuts a pipeline's state.
pub(super) fn limit_state(state: &mut PipelineState) {
    if let PipelineState::Waiting(reason) | PipelineState::Failed(reason) = state {
        limit_text(reason);
    }
}

/// Cuts a pipeline's placement.
pub(super) fn limit_placement(placement: &mut Placement) {
    let Placement { network, address, device, .. } = placement;
    [network, address, device].into_iter().flatten().for_each(limit_text);
}

/// Cuts a text at a character boundary.
pub(super) fn limit_text(text: &mut String) {
    text.truncate(text.floor_char_boundary(MAX_TEXT_BYTES));
    text.shrink_to_fit();
}

/// Cuts a list.
fn limit_list<T>(items: &mut Vec<T>, max: usize, discarded_items: &mut u64) {
    *discarded_items += items.len().saturating_sub(max) as u64;
    // Truncating keeps the capacity, so the memory is freed explicitly.
    items.truncate(max);
    items.shrink_to_fit();
}
