// Searches the pages listed in searchPages with lunr, without fetching anything.
(function () {
  "use strict";
  var index = null;

  function build() {
    index = lunr(function () {
      this.ref("number");
      this.field("title", { boost: 10 });
      this.field("text");
      searchPages.forEach(function (page, number) {
        this.add({ number: number, title: page.title, text: page.text });
      }, this);
    });
  }

  function found(query) {
    if (!index) build();
    try {
      return index.search(query);
    } catch (error) {
      return []; // an unfinished query, such as "title:"
    }
  }

  function excerpt(text, query) {
    var at = text.toLowerCase().indexOf(query.toLowerCase());
    return text.substring(Math.max(0, at - 80), Math.max(0, at - 80) + 200);
  }

  function show(results, query, box) {
    box.textContent = results.length || query.length < 3 ? "" : box.dataset.noResultsText;
    results.slice(0, 20).forEach(function (result) {
      var page = searchPages[Number(result.ref)];
      var entry = document.createElement("article");
      var link = document.createElement("a");
      link.href = base_url + "/" + page.location;
      link.textContent = page.title;
      var title = document.createElement("h3");
      title.appendChild(link);
      var text = document.createElement("p");
      text.textContent = excerpt(page.text, query);
      entry.append(title, text);
      box.appendChild(entry);
    });
  }

  document.addEventListener("DOMContentLoaded", function () {
    var input = document.getElementById("mkdocs-search-query");
    var box = document.getElementById("mkdocs-search-results");
    if (!input || !box) return;
    input.form.addEventListener("submit", function (event) { event.preventDefault(); });
    input.addEventListener("input", function () {
      var query = input.value.trim();
      show(query.length < 3 ? [] : found(query), query, box);
    });
  });
})();
