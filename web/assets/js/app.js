// What every page needs: theme, menu, keys, table views, the key of the stages, search, swapped panels.
(() => {
  const root = document.documentElement;
  const find = (selector, from = document) => from.querySelector(selector);
  const all = (selector, from = document) => Array.from(from.querySelectorAll(selector));
  const tell = (name, detail) => document.dispatchEvent(new CustomEvent(name, { detail }));

  // --- theme
  const system = matchMedia("(prefers-color-scheme: dark)");
  function switchTheme() {
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : system.matches;
    root.dataset.theme = dark ? "light" : "dark";
    try { localStorage.setItem("theme", root.dataset.theme); } catch { /* then for this page only */ }
    tell("peer-theme");
  }
  system.addEventListener("change", () => tell("peer-theme"));
  // Paper is light.
  let worn;
  addEventListener("beforeprint", () => {
    worn = root.dataset.theme;
    root.dataset.theme = "light";
    tell("peer-theme", "print");
  });
  addEventListener("afterprint", () => {
    if (worn) root.dataset.theme = worn; else delete root.dataset.theme;
    tell("peer-theme");
  });

  // --- menu of the phone
  function toggleMenu() {
    const open = find("#pages").classList.toggle("open");
    find("#menu").setAttribute("aria-expanded", String(open));
  }

  // --- views: of several, one is shown; or a chart flips to its table
  function choose(button) {
    for (const other of all("[data-shows]", button.closest(".seg"))) {
      const on = other === button;
      const view = document.getElementById(other.dataset.shows);
      other.setAttribute("aria-pressed", String(on));
      view.classList.toggle(view.classList.contains("alternative") ? "shown" : "flipped", view.classList.contains("alternative") ? on : !on);
    }
  }
  function flip(button) {
    const on = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(on));
    document.getElementById(button.dataset.flips).classList.toggle("flipped", on);
    document.getElementById(button.dataset.table).classList.toggle("shown", on);
  }

  // --- the key: a click shows one stage alone, a second click all again
  function isolate(button) {
    const buttons = all("#key button[data-stage]");
    const shown = buttons.filter((other) => other.getAttribute("aria-pressed") === "true");
    const back = shown.length === 1 && shown[0] === button;
    for (const other of buttons) other.setAttribute("aria-pressed", String(back || other === button));
    tell("peer-isolate", back ? null : button.dataset.stage);
  }

  function chooseRange(button) {
    for (const other of all("#range button")) other.setAttribute("aria-pressed", String(other === button));
    tell("peer-range", Number(button.dataset.seconds));
  }

  // --- search in the list of the page
  function filter() {
    const search = find("#search");
    if (!search) return;
    const words = search.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of all("tbody tr", document.getElementById(search.dataset.filters))) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
    }
  }

  // --- links that change one panel: the page is fetched, the panel taken out of it
  async function swap(link) {
    const id = link.dataset.swap;
    const href = link.href;
    const panel = document.getElementById(id);
    try {
      const answer = await fetch(href);
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      const page = new DOMParser().parseFromString(await answer.text(), "text/html");
      panel.replaceWith(page.getElementById(id));
      const inTable = link.classList.contains("pick");
      for (const pick of all("a.pick")) {
        const fresh = all("a.pick", page).find((other) => other.textContent === pick.textContent);
        if (!fresh) continue;
        pick.setAttribute("href", fresh.getAttribute("href"));
        pick.closest("tr").className = fresh.closest("tr").className;
        if (fresh.hasAttribute("aria-current")) pick.setAttribute("aria-current", "true");
        else pick.removeAttribute("aria-current");
      }
      history.replaceState(null, "", href);
      if (!inTable) all(`#${id} a`).find((other) => other.textContent === link.textContent)?.focus();
    } catch {
      location.href = href;
    }
  }

  // --- a run that is pinned: pressed, and said beside its name
  async function pin(button) {
    if (button.ariaBusy === "true") return;
    const on = button.getAttribute("aria-pressed") !== "true", said = find("#pin-said");
    button.ariaBusy = "true";
    said.textContent = "";
    try {
      const answer = await fetch(button.dataset.pin, { method: on ? "PUT" : "DELETE" });
      if (!answer.ok) throw new Error((await answer.json()).detail);
      button.setAttribute("aria-pressed", String(on));
      button.querySelector("span").textContent = on ? "Pinned" : "Pin";
      button.title = on ? "Unpin" : "Pin: nothing of this run is deleted by age";
      find("#pinned").hidden = !on;
    } catch (error) {
      said.textContent = `Not changed: ${error.message}`;
    } finally {
      button.ariaBusy = null;
    }
  }

  async function copy(button) {
    const text = button.parentElement.querySelector("pre").textContent;
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "Copied";
    } catch {
      // Not allowed here: the text is selected, ready for the keyboard.
      getSelection().selectAllChildren(button.parentElement.querySelector("pre"));
    }
  }

  document.addEventListener("click", (event) => {
    const at = (selector) => event.target.closest(selector);
    const plain = !event.ctrlKey && !event.metaKey && !event.shiftKey && event.button === 0;
    let hit;
    if (at("#theme")) switchTheme();
    else if (at("#menu")) toggleMenu();
    else if (at("#keys")) find("#keyhelp").showModal();
    else if (at("#pause")) tell("peer-toggle-pause");
    else if ((hit = at("#pin"))) pin(hit);
    else if ((hit = at("[data-copy]"))) copy(hit);
    else if ((hit = at("[data-shows]"))) choose(hit);
    else if ((hit = at("[data-flips]"))) flip(hit);
    else if ((hit = at("#key button[data-stage]"))) isolate(hit);
    else if ((hit = at("#range button"))) chooseRange(hit);
    else if (plain && (hit = at("a[data-swap]"))) { event.preventDefault(); swap(hit); }
  });
  document.addEventListener("input", (event) => { if (event.target.id === "search") filter(); });
  document.addEventListener("peer-updated", filter);

  // --- keys; one that has nothing to do on a page stays the browser's: the space bar scrolls
  let afterG = 0;
  const press = (selector) => { const found = find(selector); return found && (() => found.click()); };
  const keys = {
    t: () => switchTheme,
    "?": () => () => find("#keyhelp").showModal(),
    "/": () => () => (find("#search") || find(".nav a")).focus(),
    " ": (event) => !event.shiftKey && press("#pause"),
    ArrowLeft: () => press("a[rel=prev]"),
    ArrowRight: () => press("a[rel=next]"),
  };
  document.addEventListener("keydown", (event) => {
    const target = event.target;
    if (event.ctrlKey || event.metaKey || event.altKey || target.closest("input, textarea, select, dialog")) return;
    if (event.key === " " && target.closest("button, a, summary, [role=button]")) return;
    // Arrows scroll what has the focus and can scroll sideways.
    if (event.key.startsWith("Arrow") && target.scrollWidth > target.clientWidth && target.matches(".scroll, pre")) return;
    if (event.timeStamp - afterG < 1500 && afterG) {
      afterG = 0;
      const link = find(`.nav a[data-key="${CSS.escape(event.key)}"]`);
      if (link) { event.preventDefault(); location.href = link.href; return; }
    }
    if (event.key === "g") { afterG = event.timeStamp; return; }
    const action = keys[event.key]?.(event);
    if (action) { event.preventDefault(); action(); }
  });
})();
