// Behaviour of every page: theme, menu, keyboard, table views, key of the stages, search, swapped panels.
(() => {
  const root = document.documentElement;
  const find = (selector, from = document) => from.querySelector(selector);
  const findAll = (selector, from = document) => Array.from(from.querySelectorAll(selector));
  const dispatch = (name, detail) => document.dispatchEvent(new CustomEvent(name, { detail }));

  // --- theme
  const system = matchMedia("(prefers-color-scheme: dark)");
  function switchTheme() {
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : system.matches;
    root.dataset.theme = dark ? "light" : "dark";
    try { localStorage.setItem("theme", root.dataset.theme); } catch { /* Storage may be forbidden: the theme then lasts for this page only. */ }
    dispatch("peernet-theme");
  }
  system.addEventListener("change", () => dispatch("peernet-theme"));
  // Printed pages use the light theme.
  let themeBeforePrint;
  addEventListener("beforeprint", () => {
    themeBeforePrint = root.dataset.theme;
    root.dataset.theme = "light";
    dispatch("peernet-theme", "print");
  });
  addEventListener("afterprint", () => {
    if (themeBeforePrint) root.dataset.theme = themeBeforePrint; else delete root.dataset.theme;
    dispatch("peernet-theme");
  });

  // --- menu on small screens
  function toggleMenu() {
    const open = find("#pages").classList.toggle("open");
    find("#menu").setAttribute("aria-expanded", String(open));
  }

  // --- alternative views: one of several views is shown, or a table replaces a chart
  function selectView(button) {
    for (const other of findAll("[data-shows]", button.closest(".seg"))) {
      const isSelected = other === button;
      const view = document.getElementById(other.dataset.shows);
      other.setAttribute("aria-pressed", String(isSelected));
      // A view with the class `alternative` is hidden unless it has `shown`. Any other view is visible unless it has `flipped`.
      const isAlternative = view.classList.contains("alternative");
      view.classList.toggle(isAlternative ? "shown" : "flipped", isAlternative ? isSelected : !isSelected);
    }
  }
  function toggleTable(button) {
    const showTable = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(showTable));
    document.getElementById(button.dataset.flips).classList.toggle("flipped", showTable);
    document.getElementById(button.dataset.table).classList.toggle("shown", showTable);
  }

  // --- key of the stages: a click shows one stage only, a second click shows all again
  function isolateStage(button) {
    const buttons = findAll("#key button[data-stage]");
    const shown = buttons.filter((other) => other.getAttribute("aria-pressed") === "true");
    const showAll = shown.length === 1 && shown[0] === button;
    for (const other of buttons) other.setAttribute("aria-pressed", String(showAll || other === button));
    dispatch("peernet-isolate", showAll ? null : button.dataset.stage);
  }

  function selectRange(button) {
    for (const other of findAll("#range button")) other.setAttribute("aria-pressed", String(other === button));
    dispatch("peernet-range", Number(button.dataset.seconds));
  }

  // --- search in the list of the page
  function filterRows() {
    const search = find("#search");
    if (!search) return;
    const words = search.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of findAll("tbody tr", document.getElementById(search.dataset.filters))) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
    }
  }

  // --- links that change one panel: the page is fetched, and only the panel is replaced
  async function swapPanel(link) {
    const id = link.dataset.swap;
    const href = link.href;
    const panel = document.getElementById(id);
    try {
      const answer = await fetch(href);
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      const page = new DOMParser().parseFromString(await answer.text(), "text/html");
      panel.replaceWith(page.getElementById(id));
      // The table of the stages is outside the panel. Its rows mark the stage that the panel shows, and link to the panel's other stages.
      const inTable = link.classList.contains("pick");
      for (const pick of findAll("a.pick")) {
        const fresh = findAll("a.pick", page).find((other) => other.textContent === pick.textContent);
        if (!fresh) continue;
        pick.setAttribute("href", fresh.getAttribute("href"));
        pick.closest("tr").className = fresh.closest("tr").className;
        if (fresh.hasAttribute("aria-current")) pick.setAttribute("aria-current", "true");
        else pick.removeAttribute("aria-current");
      }
      history.replaceState(null, "", href);
      if (!inTable) findAll(`#${id} a`).find((other) => other.textContent === link.textContent)?.focus();
    } catch {
      location.href = href;
    }
  }

  // --- pinning of a run
  async function togglePin(button) {
    if (button.ariaBusy === "true") return;
    const pin = button.getAttribute("aria-pressed") !== "true", message = find("#pin-said");
    button.ariaBusy = "true";
    message.textContent = "";
    try {
      const answer = await fetch(button.dataset.pin, { method: pin ? "PUT" : "DELETE" });
      if (!answer.ok) throw new Error((await answer.json()).detail);
      button.setAttribute("aria-pressed", String(pin));
      button.querySelector("span").textContent = pin ? "Pinned" : "Pin";
      button.title = pin ? "Unpin" : "Pin: nothing of this run is deleted by age";
      find("#pinned").hidden = !pin;
    } catch (error) {
      message.textContent = `Not changed: ${error.message}`;
    } finally {
      button.ariaBusy = null;
    }
  }

  async function copyText(button) {
    const text = button.parentElement.querySelector("pre").textContent;
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "Copied";
    } catch {
      // The browser forbids the use of the clipboard. The text is selected instead, so that the user can copy it.
      getSelection().selectAllChildren(button.parentElement.querySelector("pre"));
    }
  }

  document.addEventListener("click", (event) => {
    const at = (selector) => event.target.closest(selector);
    // With one of these keys, a click opens the link in another tab or window.
    const plain = !event.ctrlKey && !event.metaKey && !event.shiftKey && event.button === 0;
    let hit;
    if (at("#theme")) switchTheme();
    else if (at("#menu")) toggleMenu();
    else if (at("#keys")) find("#keyhelp").showModal();
    else if (at("#pause")) dispatch("peernet-toggle-pause");
    else if ((hit = at("#pin"))) togglePin(hit);
    else if ((hit = at("[data-copy]"))) copyText(hit);
    else if ((hit = at("[data-shows]"))) selectView(hit);
    else if ((hit = at("[data-flips]"))) toggleTable(hit);
    else if ((hit = at("#key button[data-stage]"))) isolateStage(hit);
    else if ((hit = at("#range button"))) selectRange(hit);
    else if (plain && (hit = at("a[data-swap]"))) { event.preventDefault(); swapPanel(hit); }
  });
  document.addEventListener("input", (event) => { if (event.target.id === "search") filterRows(); });
  document.addEventListener("peernet-updated", filterRows);

  // --- keyboard; a key without an action on this page keeps its action in the browser, such as scrolling by the space bar
  let gPressedAt = 0;
  const clickAction = (selector) => { const found = find(selector); return found && (() => found.click()); };
  // For each key: a function that returns the key's action, or a false value if the page has no such action.
  const keys = {
    t: () => switchTheme,
    "?": () => () => find("#keyhelp").showModal(),
    "/": () => () => (find("#search") || find(".nav a")).focus(),
    " ": (event) => !event.shiftKey && clickAction("#pause"),
    ArrowLeft: () => clickAction("a[rel=prev]"),
    ArrowRight: () => clickAction("a[rel=next]"),
  };
  document.addEventListener("keydown", (event) => {
    const target = event.target;
    if (event.ctrlKey || event.metaKey || event.altKey || target.closest("input, textarea, select, dialog")) return;
    if (event.key === " " && target.closest("button, a, summary, [role=button]")) return;
    // Arrow keys scroll the focused element if it can scroll sideways.
    if (event.key.startsWith("Arrow") && target.scrollWidth > target.clientWidth && target.matches(".scroll, pre")) return;
    // The second key of a pair such as `g` `r` must follow within 1.5 s.
    if (event.timeStamp - gPressedAt < 1500 && gPressedAt) {
      gPressedAt = 0;
      const link = find(`.nav a[data-key="${CSS.escape(event.key)}"]`);
      if (link) { event.preventDefault(); location.href = link.href; return; }
    }
    if (event.key === "g") { gPressedAt = event.timeStamp; return; }
    const action = keys[event.key]?.(event);
    if (action) { event.preventDefault(); action(); }
  });
})();
