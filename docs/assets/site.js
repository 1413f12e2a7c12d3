// What the theme leaves out.

// Commands are copied without prompts and output.
document.addEventListener(
  "click",
  (event) => {
    const button = event.target.closest(".md-clipboard, .md-code__button");
    const code = button && button.closest(".highlight")?.querySelector("code");
    if (!code || !code.querySelector(".gp")) return;
    const commands = code.textContent
      .split("\n")
      .filter((line) => line.startsWith("$ ") || line.startsWith("> "))
      .map((line) => line.slice(2));
    button.removeAttribute("data-clipboard-target");
    button.setAttribute("data-clipboard-text", commands.join("\n"));
  },
  true,
);

// The search has a name.
document.querySelector(".md-search[role=dialog]")?.setAttribute("aria-label", "Search");

// On a narrow screen drawings and tables are pushed sideways: with the keyboard, too.
document
  .querySelectorAll('.md-typeset p > img[src$=".svg"]:not([src*="/blocks/"])')
  .forEach((img) => img.parentElement.setAttribute("tabindex", "0"));
window.addEventListener("load", () =>
  document
    .querySelectorAll(".md-typeset__scrollwrap")
    .forEach((table) => table.setAttribute("tabindex", "0")),
);
