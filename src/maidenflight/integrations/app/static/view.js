/* A view within the page: follows its theme, and takes new charts without being loaded again. */
addEventListener("storage", event => { if (event.key === "theme") dress(event.newValue ?? "auto"); });

window.renew = async address => {
  const answer = await fetch(address), next = new DOMParser().parseFromString(await answer.text(), "text/html");
  for (const figure of document.querySelectorAll("figure.chart")) {
    const old = figure.querySelector("script"), now = next.getElementById(figure.id)?.querySelector("script");
    if (!now || now.textContent === old.textContent) continue;
    figure.style.minHeight = `${figure.getBoundingClientRect().height}px`; // the page must not jump
    for (const view of drawings.get(figure) ?? []) view.finalize();
    drawings.delete(figure);
    for (const part of figure.querySelectorAll(".head, .panels")) part.remove();
    old.textContent = now.textContent;
    drawFigure(figure);
    figure.style.minHeight = "";
  }
};
