//! Limits for an agent's statements: they are cut to what the live state keeps, so that its memory is bounded whatever
//! is sent.

use peernet_stream::{
    Accounting, Connection, HostClock, HostDescription, LinkLive, NetworkInterface, PipelineState, Placement,
    Probing, ReflectorLive,
};

use peernet_store::plausible;

/// Longest list: network names, accelerators, steps of an injected clock fault.
const MAX_LIST_ITEMS: usize = 32;
/// Largest number of models that a host offers.
const MAX_MODELS: usize = 256;
/// Longest text, bytes.
const MAX_TEXT_BYTES: usize = 512;

/// Cuts a link's state and removes impossible clock values. The number of removed items is added to `left_out`.
pub(super) fn link(live: &mut LinkLive, left_out: &mut u64) {
    list(&mut live.networks, MAX_LIST_ITEMS, left_out);
    live.networks.iter_mut().for_each(text);
    list(&mut live.pipelines, MAX_LIST_ITEMS, left_out);
    probing(&mut live.probing);
    if let Some(named) = &mut live.reflector {
        reflector(named, left_out);
    }
    list(&mut live.connections, MAX_LIST_ITEMS, left_out);
    live.connections.iter_mut().for_each(connection);
    for theirs in [&mut live.edge, &mut live.cloud].into_iter().flatten() {
        clock(theirs, left_out);
    }
    let now = &mut live.now;
    let offset = now.offset.as_ref().and_then(plausible::offset);
    let (up, down) = (now.up.map(plausible::delays), now.down.map(plausible::delays));
    // Compared by value: not-a-number is unequal to itself, so it is removed and counted, too.
    let basis = now.basis.map(plausible::basis);
    *left_out += u64::from((&offset, up, down, basis) != (&now.offset, now.up, now.down, now.basis));
    (now.offset, now.up, now.down, now.basis) = (offset, up, down, basis);
}

/// Cuts the state of probing.
fn probing(probing: &mut Probing) {
    match probing {
        Probing::On { address, stamps, .. } => [address, stamps].into_iter().for_each(text),
        Probing::Unanswered { address, reason } => [address].into_iter().chain(reason).for_each(text),
        Probing::Off(reason) => text(reason),
    }
}

/// Cuts the state of a link's reflector.
fn reflector(reflector: &mut ReflectorLive, left_out: &mut u64) {
    text(&mut reflector.address);
    probing(&mut reflector.probing);
    let offset = reflector.offset.as_ref().and_then(plausible::offset);
    *left_out += u64::from(offset != reflector.offset);
    reflector.offset = offset;
}

/// Cuts a connection of a link.
fn connection(connection: &mut Connection) {
    let Connection { local, remote, interface, .. } = connection;
    [local, remote].into_iter().flatten().for_each(text);
    if let Some(NetworkInterface { name, kind, .. }) = interface {
        text(name);
        kind.iter_mut().for_each(text);
    }
}

/// Cuts a host's clock state.
pub(super) fn clock(clock: &mut HostClock, left_out: &mut u64) {
    text(&mut clock.text);
    clock.clocksource.iter_mut().for_each(text);
    if let Some(faults) = &mut clock.faults {
        list(&mut faults.steps, MAX_LIST_ITEMS, left_out);
    }
}

/// Cuts a host's description.
pub(crate) fn description(description: &mut HostDescription, left_out: &mut u64) {
    let hardware = &mut description.hardware;
    list(&mut hardware.gpus, MAX_LIST_ITEMS, left_out);
    list(&mut description.models, MAX_MODELS, left_out);
    let texts =
        [&mut description.version, &mut hardware.cpu, &mut hardware.system, &mut hardware.architecture];
    texts.into_iter().chain(&mut hardware.gpus).chain(&mut description.serves).for_each(text);
}

/// Cuts a host's accounting of events.
pub(super) fn accounting(accounting: &mut Accounting) {
    accounting.trouble.iter_mut().for_each(text);
}

/// Cuts a pipeline's state.
pub(super) fn state(state: &mut PipelineState) {
    if let PipelineState::Waiting(why) | PipelineState::Failed(why) = state {
        text(why);
    }
}

/// Cuts a pipeline's placement.
pub(super) fn placement(placement: &mut Placement) {
    let Placement { network, address, device, .. } = placement;
    [network, address, device].into_iter().flatten().for_each(text);
}

/// Cuts a text at a character boundary.
pub(super) fn text(text: &mut String) {
    text.truncate(text.floor_char_boundary(MAX_TEXT_BYTES));
    text.shrink_to_fit();
}

/// Cuts a list.
fn list<T>(items: &mut Vec<T>, max: usize, left_out: &mut u64) {
    *left_out += items.len().saturating_sub(max) as u64;
    // Truncating keeps the capacity, so that memory is freed explicitly.
    items.truncate(max);
    items.shrink_to_fit();
}
